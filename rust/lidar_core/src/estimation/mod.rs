//! Kalman filtering, chi-square quantiles and association: what all trackers share.
