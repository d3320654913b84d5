//! Euclidean clustering.
