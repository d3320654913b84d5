#!/bin/sh
# rustc for the driver: crates of this repository count every edge, and have ten planted bugs.
set -eu
case " $* " in
*" --crate-name lidar_"*)
    exec "$@" -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=3 \
        -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
        -Cllvm-args=-sanitizer-coverage-pc-table \
        -Cllvm-args=-sanitizer-coverage-trace-compares \
        $(seq -f '--cfg canary_%g' 10)
    ;;
*) exec "$@" ;;
esac
