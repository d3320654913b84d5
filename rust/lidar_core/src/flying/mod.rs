//! Flying-object detection and tracking in 3D scans. Source: Vrba, Walter & Saska, "On Onboard LiDAR-based Flying Object Detection".
