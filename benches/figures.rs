//! Figures that a bench leaves as JSON for `make figures`.

use std::fmt::Write;
use std::path::Path;

/// A figure: its name, and named values.
pub type Figure<'a> = (String, Vec<(&'a str, f64)>);

/// Write the figures of a bench into the folder that `LIDAR_CORE_FIGURES` names; do nothing without
/// that variable.
///
/// # Errors
/// The file cannot be written.
pub fn keep(bench: &str, figures: &[Figure<'_>]) -> std::io::Result<()> {
    let Some(folder) = std::env::var_os("LIDAR_CORE_FIGURES") else { return Ok(()) };
    std::fs::create_dir_all(&folder)?;
    std::fs::write(Path::new(&folder).join(format!("{bench}.json")), text(figures))
}

/// The figures as a JSON object of objects; a value that is not finite is null.
fn text(figures: &[Figure<'_>]) -> String {
    let mut text = String::from("{");
    for (number, (name, values)) in figures.iter().enumerate() {
        let comma = if number == 0 { "" } else { "," };
        let _ = write!(text, "{comma}\n {name:?}: {{"); // a String is always written
        for (place, (key, value)) in values.iter().enumerate() {
            let comma = if place == 0 { "" } else { ", " };
            let value = if value.is_finite() { value.to_string() } else { "null".to_owned() };
            let _ = write!(text, "{comma}{key:?}: {value}");
        }
        text.push('}');
    }
    text + "\n}\n"
}
