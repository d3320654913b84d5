//! LiDAR and radar simulator.
