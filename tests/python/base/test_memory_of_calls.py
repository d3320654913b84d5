"""Short calls, one after the other: the process keeps the memory of one of them, not of many."""

import platform
import subprocess
import sys

import pytest

CALLS = 2000
PROGRAM = """
import ctypes, sys, tempfile
import numpy as np
import lidar_core as lc

libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p

def arenas():
    with tempfile.NamedTemporaryFile("r") as file:
        stream = ctypes.c_void_p(libc.fopen(file.name.encode(), b"w"))
        libc.malloc_info(0, stream)
        libc.fclose(stream)
        return file.read().count("<heap ")

points = np.zeros((20, 3), np.float32)
call = lambda: lc.cluster_points(points, max_distance=0.5, min_points=1)
call()
print(arenas())
for _ in range(int(sys.argv[1])):
    call()
print(arenas())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="malloc of glibc has arenas")
def test_each_call_works_in_the_arena_of_the_one_before():
    """Blocks that one call allocates and a later one frees fill an arena per call otherwise."""
    command = [sys.executable, "-c", PROGRAM, str(CALLS)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, last = done.stdout.split()
    assert last == first
