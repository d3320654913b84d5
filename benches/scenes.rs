//! Seeded scenes shared by the benches.
