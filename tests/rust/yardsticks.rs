//! Tests of the yardsticks of the benches: they do the same work as the kernels. They run here because the tests of the
//! benches' own crate need criterion, which brings other features of shared crates: all of them would be built twice.

#[path = "../../benches/scenes.rs"]
#[allow(dead_code, unreachable_pub, reason = "the benches use the rest")]
mod scenes;
