//! A predict and an update of every filter, over whole recordings of LiDAR and radar in turn.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lidar_core::Error;
use lidar_core::fusion::models::motion::NoiseForm;
use lidar_core::fusion::models::platform::GyroUse;
use lidar_core::fusion::{
    Filter, FusionParameters, Measurement, Method, Model, Sensor, Strengths, run, run_batch,
};
use lidar_core::util::threads;

const STEPS: usize = 1223;
const TARGETS: usize = 100;

/// What ships, with another model and method.
fn parameters(model: Model, method: Method) -> FusionParameters {
    let mut parameters = FusionParameters { model, method, ..FusionParameters::default() };
    parameters.life.gyro = GyroUse::Measurement; // one more state
    parameters
}

/// A target that walks a wide circle, with errors that only look random.
fn recording() -> Result<Vec<Measurement>, Error> {
    (0..=STEPS)
        .map(|step| {
            let t = step as f64 * 0.05;
            let noise = |phase: f64| 0.2 * (step as f64 * 12.9898 + phase).sin();
            let heading = 0.3 * t;
            let [x, y] = [8.0 + 5.0 * heading.sin(), 3.0 - 5.0 * heading.cos()];
            let [vx, vy] = [1.5 * heading.cos(), 1.5 * heading.sin()];
            let stamp = step as i64 * 50_000_000;
            if step % 2 == 0 {
                let position = [x + noise(0.0), y + noise(1.0)];
                return Measurement::new(stamp, Sensor::Lidar, &position, None);
            }
            let range = x.hypot(y);
            let rate = (x * vx + y * vy) / range + noise(2.0);
            let bearing = y.atan2(x) + 0.1 * noise(3.0);
            Measurement::new(stamp, Sensor::Radar, &[range + noise(4.0), bearing, rate], None)
        })
        .collect()
}

fn fusion(c: &mut Criterion) -> Result<(), Error> {
    let target = recording()?;
    let unscented = Method::Sigma { spread: None, carries: false };
    let mut group = c.benchmark_group("fusion");
    group.throughput(Throughput::Elements(STEPS as u64));
    for (name, model, method) in [
        ("cv_ekf", Model::ConstantVelocity, Method::Extended),
        ("ctrv_ekf", Model::Ctrv, Method::Extended),
        ("ctrv_ukf", Model::Ctrv, unscented),
        ("ctra_ekf", Model::Ctra, Method::Extended),
        ("ctrv_drone_ekf", Model::CtrvDrone, Method::Extended),
    ] {
        let settings = parameters(model, method);
        group.bench_function(name, |b| b.iter(|| run(&settings, &target)));
    }
    let settings = parameters(Model::Ctra, Method::Extended);
    group.bench_function("ctra_ekf_step_by_step", |b| {
        b.iter(|| {
            Filter::new(&settings).map(|mut filter| {
                target.iter().map(|m| filter.step(m).stamp_ns).max() // a step is a Step by value
            })
        })
    });
    group.throughput(Throughput::Elements((TARGETS * STEPS) as u64));
    let (pool, targets) = (threads::pool(1)?, vec![&target[..]; TARGETS]);
    group.sample_size(20);
    for (name, form) in [("", NoiseForm::Continuous), ("_discrete_noise", NoiseForm::Discrete)] {
        let strengths = Strengths { form, ..settings.strengths };
        let settings = FusionParameters { strengths, ..settings };
        group.bench_function(format!("ctra_ekf_batch{name}"), |b| {
            b.iter(|| run_batch(&pool, &settings, &targets))
        });
    }
    group.finish();
    Ok(())
}

fn run_all(c: &mut Criterion) {
    if let Err(error) = fusion(c) {
        std::process::exit(i32::from(!error.to_string().is_empty()));
    }
}

criterion_group!(benches, run_all);
criterion_main!(benches);
