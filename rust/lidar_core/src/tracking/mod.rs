//! Mechanisms that every tracker needs and no filter has: how noisy a sensor really is.

pub mod sensor_noise;
