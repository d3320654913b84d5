"""What the package is made of: crates of one registry with checksums, licences, pinned actions."""

import json
import re
import shutil
import subprocess
import tomllib
from importlib.metadata import PackageNotFoundError, distribution

import pytest
from repository import ROOT

MOST_CRATES = 150
"""Budget for all crates of Cargo.lock, those of tests and benches included."""
ACTION = re.compile(r"uses: *([^\s@]+)@(\S+)")
DENY = tomllib.loads((ROOT / "deny.toml").read_text())
LOCK = tomllib.loads((ROOT / "Cargo.lock").read_text())
FUZZ_LOCK = tomllib.loads((ROOT / "fuzz" / "Cargo.lock").read_text())
WORKSPACE = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


@pytest.mark.parametrize("lock", [LOCK, FUZZ_LOCK], ids=["package", "fuzz"])
def test_every_crate_is_of_the_registry_and_has_a_checksum(lock):
    own = {"lidar_core", "lidar_sim", "lidar_core_py", "lidar_core_benches", "lidar_core_fuzz"}
    others = [crate for crate in lock["package"] if crate["name"] not in own]
    allowed = {f"registry+{place}" for place in DENY["sources"]["allow-registry"]}
    assert len(others) <= MOST_CRATES
    assert {crate["source"] for crate in others} == allowed
    assert all(re.fullmatch(r"[0-9a-f]{64}", crate["checksum"]) for crate in others)


def is_allowed(licence, allowed):
    """Whether an SPDX expression has a choice of allowed licences only."""
    words = licence.replace("/", " OR ").replace("(", " ( ").replace(")", " ) ")
    words = re.sub(r"(\S+) WITH (\S+)", r"\1_WITH_\2", words).split()
    known = {name.replace(" WITH ", "_WITH_") for name in allowed}
    plain = {"(": "(", ")": ")", "OR": "or", "AND": "and"}
    told = " ".join(plain.get(word, str(word in known)) for word in words)
    while "(" in told:
        told = re.sub(r"\( ([^()]*) \)", lambda found: str(holds(found[1])), told)
    return holds(told)


def holds(told):
    """The value of True and False joined by `and` before `or`."""
    return any(all(one == "True" for one in part.split(" and ")) for part in told.split(" or "))


@pytest.mark.parametrize(
    ("licence", "expected"),
    [
        ("MIT/Apache-2.0", True),
        ("GPL-3.0 OR MIT", True),
        ("GPL-3.0 AND MIT", False),
        ("(MIT OR GPL-3.0) AND Unicode-3.0", True),
        ("(GPL-2.0 OR GPL-3.0) AND Unicode-3.0", False),
        ("Apache-2.0 WITH LLVM-exception", True),
        ("Apache-2.0 WITH other", False),
    ],
)
def test_expressions_of_licences(licence, expected):
    assert is_allowed(licence, DENY["licenses"]["allow"]) is expected


@pytest.mark.parametrize("folder", [ROOT, ROOT / "fuzz"], ids=["package", "fuzz"])
def test_every_licence_is_allowed(folder):
    """What `cargo deny check licenses` asks, for those who have no cargo-deny."""
    if shutil.which("cargo") is None:
        pytest.skip("needs cargo")
    told = ["cargo", "metadata", "--locked", "--offline", "--format-version", "1"]
    done = subprocess.run(told, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("the crates are not on this machine")
    found = {one["name"]: one["license"] for one in json.loads(done.stdout)["packages"]}
    assert found
    also = {one["crate"]: one["allow"] for one in DENY["licenses"]["exceptions"]}
    bad = {
        name: one
        for name, one in found.items()
        if not is_allowed(one or "", DENY["licenses"]["allow"] + also.get(name, []))
    }
    assert bad == {}


COPYLEFT = re.compile(r"\bA?GPL|GNU (Affero )?General|Affero|SSPL|Business Source")


def test_no_allowed_licence_binds_users():
    assert [one for one in DENY["licenses"]["allow"] if COPYLEFT.search(one)] == []
    assert DENY["advisories"]["yanked"] == "deny"
    assert {DENY["sources"][what] for what in ("unknown-registry", "unknown-git")} == {"deny"}


def licence_of(metadata):
    """What a Python package says of its licence, most exact first; its whole text is no name."""
    name = metadata.get("License-Expression") or ""
    classifiers = [one for one in metadata.get_all("Classifier") or [] if "License ::" in one]
    stated = (metadata.get("License") or "").strip().splitlines()[:1]
    return name or " AND ".join(classifiers) or " ".join(stated)


def required(names, extras):
    """Installed packages that those of these names need, extras of the first ones included."""
    found, left = {}, [(name, extras) for name in names]
    while left:
        name, wanted = left.pop()
        try:
            metadata = distribution(name).metadata
        except PackageNotFoundError:
            continue
        for line in metadata.get_all("Requires-Dist") or []:
            extra = re.search(r"extra == ['\"]([\w-]+)", line)
            other = re.match(r"[\w.-]+", line)[0].lower()
            if (extra is None or extra[1] in wanted) and other not in found:
                found[other] = None
                left.append((other, ()))
        found[name] = licence_of(metadata)
    return {name: one for name, one in found.items() if one is not None}


def test_packages_of_python_bind_no_users():
    extras = set(
        tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    )
    found = required(["lidar-core"], extras - {"train"})
    assert {"numpy", "onnxruntime", "lidar-core"} <= found.keys()
    assert [name for name, one in found.items() if not one] == []
    assert {name: one for name, one in found.items() if binds_users(one)} == {}


def binds_users(licence):
    """Whether a licence, or every one of those that may be chosen from, is GPL or AGPL."""
    return all(COPYLEFT.search(one.replace("LGPL", "")) for one in licence.split(" OR "))


@pytest.mark.parametrize(
    ("text", "binds"),
    [
        ("GPL-3.0-only", True),
        ("License :: OSI Approved :: GNU General Public License v3 (GPLv3)", True),
        ("AGPL-3.0-or-later", True),
        ("BSD-3-Clause", False),
        ("MIT", False),
        ("MIT OR GPL-3.0-only", False),
        ("GPL-2.0-only OR AGPL-3.0-only", True),
        (
            "License :: Public Domain AND License :: OSI Approved :: GNU General Public License",
            True,
        ),
    ],
)
def test_licences_that_bind_are_known(text, binds):
    assert binds_users(text) is binds


@pytest.mark.parametrize("workflow", WORKFLOWS, ids=lambda path: path.stem)
def test_actions_are_pinned_by_commit(workflow):
    actions = ACTION.findall(workflow.read_text())
    assert actions
    assert [name for name, pin in actions if not re.fullmatch(r"[0-9a-f]{40}", pin)] == []


def test_an_action_has_one_pin():
    pins = {pair for path in WORKFLOWS for pair in ACTION.findall(path.read_text())}
    assert len({name for name, _ in pins}) == len(pins)


def test_pushes_run_everything_and_the_oldest_rust():
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text()
    assert "pull_request:" in text
    assert "- run: .ci/run" in text
    read = re.search(r"oldest=\"\$\(sed -n '(.*)' Cargo.toml\)\"", text)
    assert read is not None
    done = subprocess.run(
        ["sed", "-n", read[1], "Cargo.toml"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == WORKSPACE["package"]["rust-version"]
