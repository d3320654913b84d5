"""Programs of C++ and Rust that the bench needs, built below `target/peers`; nothing is installed.

OctoMap and PCL come from Debian: packages are unpacked, not installed, which takes no rights. Each
program is built twice: as Debian builds its packages, and for processors with AVX2. PCL's
templates are then compiled anew, since the library holds them for the oldest processor.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
BUILT = TARGET / "peers"
SYSTEM = BUILT / "debian"
LEAST_FREE_BYTES = 8e9
HEADERS = ["libpcl-dev", "libflann-dev", "liblz4-dev", "libeigen3-dev", "liboctomap-dev"]
PLAIN = "as Debian builds it"
NEWEST = ["-O3", "-march=x86-64-v3"]
LINKED = {
    "octomap": ["octomap", "octomath"],
    "pcl": ["pcl_segmentation", "pcl_search", "pcl_kdtree", "pcl_common", "flann_cpp", "lz4"],
}
COMPILED_ANEW = {"octomap": [], "pcl": ["-DPCL_NO_PRECOMPILE", "-DEIGEN_MAX_ALIGN_BYTES=16"]}
"""The second keeps the layout of what the library, built without AVX, hands over."""


class MissingError(Exception):
    """Something that a peer needs is not there; the text is a sentence."""


def yardstick() -> Path:
    """Build the program of the bench crate."""
    command = ["cargo", "build", "--quiet", "--locked", "--release"]
    command += ["-p", "lidar_core_benches", "--bin", "yardstick"]
    subprocess.run(command, cwd=ROOT, check=True, env={**os.environ, "CARGO_TARGET_DIR": TARGET})
    return TARGET / "release" / "yardstick"


def programs(name: str) -> dict[str, Path]:
    """Build `octomap` or `pcl`: how it was built, and where it is."""
    if shutil.which("g++") is None:
        raise MissingError("g++ is not installed")
    unpack()
    builds = {PLAIN: ["-O2"], "-O3, AVX2": [*NEWEST, *COMPILED_ANEW[name]]}
    built = {}
    for number, (kind, flags) in enumerate(builds.items()):
        built[kind] = BUILT / f"{name}-{number}"
        sources = [HERE / f"{name}.cpp", HERE / "scans.hpp"]
        if not is_newer(built[kind], sources):
            compile_with(flags, sources[0], built[kind], LINKED[name])
    return built


def is_newer(program: Path, sources: list[Path]) -> bool:
    """Whether a program was built after the last change of its sources."""
    made = program.stat().st_mtime if program.exists() else 0.0
    return all(source.stat().st_mtime < made for source in sources)


def compile_with(flags: list[str], source: Path, program: Path, libraries: list[str]) -> None:
    """Compile one program against the unpacked packages."""
    include, (folder,) = SYSTEM / "usr/include", SYSTEM.glob("usr/lib/*-linux-gnu")
    folders = [include, include / "eigen3", *include.glob("pcl-*")]
    searched = [word for place in folders for word in ("-isystem", str(place))]
    # the old kind of path also holds for libraries that libraries need
    linked = [f"-L{folder}", f"-Wl,-rpath,{folder},--disable-new-dtags"]
    linked += [f"-l{library}" for library in libraries]
    command = ["g++", "-std=c++17", *flags, *searched, str(source), "-o", str(program), *linked]
    subprocess.run(command, check=True)


def unpack() -> None:
    """Fetch Debian's packages and unpack them, once."""
    if SYSTEM.exists():
        return
    if shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None:
        raise MissingError("packages of Debian cannot be fetched: there is no apt-get here")
    BUILT.mkdir(parents=True, exist_ok=True)
    if shutil.disk_usage(BUILT).free < LEAST_FREE_BYTES:
        raise MissingError(f"less than {LEAST_FREE_BYTES / 1e9:g} GB are free in {BUILT}")
    fetched, unpacked = BUILT / "fetched", BUILT / "unpacked"
    fetched.mkdir(exist_ok=True)
    command = ["apt-get", "--quiet", "download", *packages()]
    done = subprocess.run(command, cwd=fetched, check=False)
    if done.returncode != 0:
        raise MissingError("apt-get could not download the packages of PCL and OctoMap")
    for package in sorted(fetched.glob("*.deb")):
        subprocess.run(["dpkg-deb", "--extract", package, unpacked], check=True)
    unpacked.rename(SYSTEM)


def packages() -> list[str]:
    """The packages with headers, and the libraries and headers of their versions."""
    found = depended(*HEADERS, "libboost-dev")
    wanted = r"libflann\d.*|liboctomap\d.*|libboost\d.*-dev|libpcl-(common|features|filters"
    wanted += r"|kdtree|ml|octree|sample-consensus|search|segmentation)\d.*"
    return HEADERS + sorted(name for name in found if re.fullmatch(wanted, name))


def depended(*names: str) -> set[str]:
    """What packages say that they depend on."""
    done = subprocess.run(
        ["apt-cache", "depends", *names], capture_output=True, text=True, check=False
    )
    return set(re.findall(r"Depends: (\S+)", done.stdout))


def versions() -> str:
    """Versions of the compiler and of the unpacked libraries."""
    compiler = subprocess.run(["g++", "--version"], capture_output=True, text=True, check=True)
    found = [compiler.stdout.split("\n", 1)[0]]
    for name in ("OctoMap", "PCL"):
        shown = sorted((BUILT / "fetched").glob(f"lib{name.lower()}-dev_*.deb"))
        found += [f"{name} {package.name.split('_')[1]}" for package in shown]
    return ", ".join(found)
