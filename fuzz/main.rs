#![no_main]
//! Coverage-guided runs of one target, which `LIDAR_CORE_TARGET` names. `tests/fuzz_house/rust.py` calls it.

#[path = "../tests/rust/fuzz/mod.rs"]
mod fuzz;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{LazyLock, Mutex};

/// Planted bugs that were met.
static MET: Mutex<Vec<&str>> = Mutex::new(Vec::new());
static TARGET: LazyLock<fuzz::Body> = LazyLock::new(|| {
    let name = std::env::var("LIDAR_CORE_TARGET").unwrap_or_default();
    match fuzz::TARGETS.iter().find(|(known, _)| *known == name) {
        Some((_, body)) => *body,
        None => {
            let names: Vec<_> = fuzz::TARGETS.iter().map(|(name, _)| *name).collect();
            println!("LIDAR_CORE_TARGET is one of: {}", names.join(" "));
            std::process::exit(2)
        }
    }
});

// Panics abort in the hook of libFuzzer; planted bugs unwind without the hook.
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let body = *TARGET;
    if let Err(panic) = catch_unwind(AssertUnwindSafe(|| body(bytes))) {
        match panic.downcast::<&'static str>() {
            Ok(name) if name.starts_with("canary ") => note(*name),
            _ => std::process::abort(),
        }
    }
});

fn note(name: &'static str) {
    if let Ok(mut met) = MET.lock()
        && !met.contains(&name)
    {
        met.push(name);
        eprintln!("met {name}");
    }
}
