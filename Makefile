# Every developer command. `make help` lists them.

PYTHON ?= python3
# Environment of development, and those that `make test` makes.
VENV ?= .venv
TEST_VENV := .venv-test
OUSTER_VENV := .venv-ouster
PEERS_VENV := .venv-peers
TRAINING_VENV := .venv-training
# Index with torch built for CPUs; without it torch is that of the usual index.
TORCH_INDEX ?= $(LIDAR_CORE_TORCH_INDEX)
# A built wheel to test; without it `make test` builds one from the working tree.
WHEEL ?=
# A uv that installs in place of pip: much faster, but it does not read the configuration of pip.
UV ?=

EXTRAS := cloud,cluster,eval,io,live,odometry,velodyne,tables,plot,rerun,viz
PIP_INSTALL := -m pip install --quiet --disable-pip-version-check
# Install into the environment $(1).
install = $(if $(UV),$(UV) pip install --quiet --python $(1)/bin/python,$(1)/bin/python $(PIP_INSTALL))
BIN := $(VENV)/bin
OWN_CRATES := -p lidar_core -p lidar_sim -p lidar_core_py

export CARGO_TARGET_DIR ?= $(CURDIR)/target
export LIDAR_CORE_OUSTER_PYTHON ?= $(CURDIR)/$(OUSTER_VENV)/bin/python

.PHONY: help demo dev fmt lint lint-rust lint-python test test-env test-rust test-training bench peers figures docs golden hostile corrupt fuzz kills signals flight soak deadline memory nightly coverage wheel ci clean
.DEFAULT_GOAL := help

help: ## Show this list.
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: ## Install into .venv and run the demo: the first command of the README.
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install '.[plot]'
	$(BIN)/lidar-core demo

dev: ## Environment in .venv with an editable build, the tools and all extras.
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python $(PIP_INSTALL) --upgrade 'pip>=25.1' 'maturin>=1.9.4,<2'
	VIRTUAL_ENV=$(CURDIR)/$(VENV) $(BIN)/maturin develop --extras $(EXTRAS)
	$(BIN)/python $(PIP_INSTALL) --group dev

fmt: ## Format Rust and Python.
	cargo fmt --all
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

lint: lint-rust lint-python ## Check format, lints, types and the stub.

lint-rust: ## Only rustfmt and clippy, which checks the benches, too.
	cargo fmt --all --check
	cargo clippy --locked --workspace --all-targets -- -D warnings

lint-python: ## Only ruff, mypy and stubtest.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest lidar_core._core

test: test-env test-rust ## Install what the tests need and run them all, on a wheel.
	$(TEST_VENV)/bin/pytest -n 4 --dist loadfile
	$(TEST_VENV)/bin/pytest --doctest-modules --pyargs lidar_core

# With the profile and the crate of the wheel, which decides on features of shared crates: the tests
# link the crates that were built for the wheel. RUN=--no-run builds them.
test-rust: ## Only the tests in Rust.
	cargo test --locked --release $(OWN_CRATES) $(RUN)

nightly: test-env ## Long versions of tests, and statistics, that `make test` leaves out.
	$(TEST_VENV)/bin/pytest -n 2 --dist loadfile -m nightly
	HYPOTHESIS_PROFILE=nightly $(TEST_VENV)/bin/pytest -n 2 --dist loadfile -m hypothesis

# Child processes count, too. Rust needs `cargo install cargo-llvm-cov` and the component llvm-tools.
PART ?= tests/python
coverage: test-env ## Lines that tests reach: of Python by PART, of Rust with cargo-llvm-cov.
	$(TEST_VENV)/bin/python $(PIP_INSTALL) 'coverage>=7.10'
	mkdir -p target/coverage
	$(TEST_VENV)/bin/coverage erase
	$(TEST_VENV)/bin/coverage run -m pytest $(PART)
	$(TEST_VENV)/bin/coverage combine --quiet
	$(TEST_VENV)/bin/coverage report --skip-covered
	if cargo llvm-cov --version > /dev/null 2>&1; then \
	    cargo llvm-cov --locked -p lidar_core -p lidar_sim --summary-only; \
	else echo "Rust: no cargo-llvm-cov"; fi

# With EVIDENCE=1 the counts go into docs/evidence, also those of a run that found something.
KEPT = $(if $(EVIDENCE),--evidence; status=$$?; \
    PYTHONPATH=tests $(BIN)/python -m hostile.evidence && exit $$status)

# COUNT files, broken by SEED, each read in a child with 2 GiB and 20 s; those that end badly are
# kept in target/hostile. With MINUTES=n it stops after this time, as `make kills` does.
FOR_MINUTES = $(if $(filter command%,$(origin MINUTES)),--minutes $(MINUTES))
COUNT ?= 20000
SEED ?= 1
hostile: ## Break files of every format and of LIDAR_CORE_DATA, and read them: COUNT=n, SEED=n, EVIDENCE=1.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m hostile --count $(COUNT) \
	    --seed $(SEED) --keep $(CARGO_TARGET_DIR)/hostile $(FOR_MINUTES) $(KEPT)

# One good file per format, cut at every STEP-th offset and with every byte there damaged.
STEP ?= 1
corrupt: ## Cut and damage a file of every format at every offset: STEP=n, EVIDENCE=1.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m hostile.exhaustive --step $(STEP) \
	    $(KEPT)

# Rust targets under libFuzzer with ten planted bugs, which count as found when they are met; readers
# in Python; calls of the compiled module. What is found is kept in target/fuzz. C++ is needed.
MINUTES ?= 10
fuzz: ## Fuzz every target in turn, guided by coverage: MINUTES=n, EVIDENCE=1.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m fuzz_house --minutes $(MINUTES) \
	    --folder $(CARGO_TARGET_DIR)/fuzz $(KEPT)

KILLS ?= 300
kills: ## Kill commands that write at any time, and look at what they leave: KILLS=n, EVIDENCE=1.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m hostile.kills --count $(KILLS) \
	    --seed $(SEED) $(FOR_MINUTES) $(KEPT)

signals: ## Press Ctrl-C in calls of two million points.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m hostile.signals

# Some two hours of one core; KM=5 takes a tenth, METRES=5 between two scans half.
KM ?= 50
METRES ?= 2.5
flight: ## Fly straight on with a map of 200 MB: KM=n, METRES=n between two scans.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m endurance.flight --km $(KM) --step $(METRES)

# An hour of a LiDAR, and several hours of one core.
SCANS ?= 36000
POINTS ?= 131072
soak: ## Fly one loop for hours: memory and time per scan must not grow: SCANS=n, POINTS=n.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m endurance.soak --scans $(SCANS) --points $(POINTS)

SECONDS_OF_SCANS ?= 300
deadline: ## Ten scans per second beside a busy core and a churning page cache: SECONDS_OF_SCANS=n.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m endurance.deadline --seconds $(SECONDS_OF_SCANS)

memory: ## Work under limits of memory that are too small for it.
	PYTHONPATH=tests:tests/python/helpers:$$PYTHONPATH $(BIN)/python -m hostile.memory

# The tests run on an installed wheel, never on the working tree. ouster-sdk, with which the own
# reader is compared, pins versions that the extras cannot live with: it has an environment alone.
test-env: $(TEST_VENV)/bin/python $(OUSTER_VENV)/bin/python
	$(TEST_VENV)/bin/python $(PIP_INSTALL) --upgrade 'pip>=25.1'
	$(call install,$(OUSTER_VENV)) 'ouster-sdk>=1.0.1'
	$(if $(WHEEL),,rm -f dist/lidar_core-*.whl; $(TEST_VENV)/bin/pip wheel --no-deps --wheel-dir dist .)
	wheel=$$(ls $(or $(WHEEL),dist/lidar_core-*.whl)) && \
	$(call install,$(TEST_VENV)) --force-reinstall --no-deps "$$wheel" && \
	$(call install,$(TEST_VENV)) "$$wheel[$(EXTRAS)]" --group test

$(TEST_VENV)/bin/python $(OUSTER_VENV)/bin/python:
	$(PYTHON) -m venv $(@D)/..

# On Linux on x86-64 the usual index has torch with CUDA: some 6 GB on the disk.
test-training: ## Install torch into an environment of its own and test the training of networks.
	$(PYTHON) -m venv $(TRAINING_VENV)
	$(TRAINING_VENV)/bin/python $(PIP_INSTALL) --upgrade 'pip>=25.1'
	$(if $(TORCH_INDEX),$(TRAINING_VENV)/bin/python $(PIP_INSTALL) --index-url "$(TORCH_INDEX)" torch)
	$(TRAINING_VENV)/bin/python $(PIP_INSTALL) "$(or $(WHEEL),.)[plot]" ./training --group test
	$(TRAINING_VENV)/bin/pytest training/tests

# With `make dev` or `make test-env` and recordings in LIDAR_CORE_DATA, real scans are measured, too.
bench: ## Measure every stage (criterion); needs no Python.
	for venv in $(VENV) $(TEST_VENV); do \
	    [ ! -x $$venv/bin/python ] || \
	        ! $$venv/bin/python -W ignore benches/recorded.py $(CARGO_TARGET_DIR)/recorded || break; \
	done
	if [ -d $(CARGO_TARGET_DIR)/recorded ]; then \
	    export LIDAR_CORE_SCANS=$(CARGO_TARGET_DIR)/recorded; \
	fi; cargo bench --locked

# Packages of Debian are unpacked below target/peers, not installed. Open3D has no wheel for every
# Python: without it the simulator is left out.
peers: ## Measure lidar_core beside OctoMap, PCL, scipy and others, in an environment of their own.
	$(PYTHON) -m venv $(PEERS_VENV)
	$(PEERS_VENV)/bin/python $(PIP_INSTALL) -r benches/peers/requirements.txt .
	-$(PEERS_VENV)/bin/python $(PIP_INSTALL) open3d
	$(PEERS_VENV)/bin/python -W ignore benches/peers/run.py

# An idle machine is needed: nothing here repeats what another process has disturbed.
figures: ## Measure speed and memory, and write them into README and guide.
	rm -rf $(CARGO_TARGET_DIR)/figures $(CARGO_TARGET_DIR)/criterion
	LIDAR_CORE_FIGURES=$(CARGO_TARGET_DIR)/figures $(MAKE) bench
	$(MAKE) peers
	$(PYTHON) benches/figures.py collect $(CARGO_TARGET_DIR)/criterion $(CARGO_TARGET_DIR)/figures
	$(PYTHON) benches/figures.py write

docs: ## Build the guide with the parameter reference into site/.
	$(BIN)/python docs/generate_parameters.py
	$(BIN)/mkdocs build --strict

golden: ## Write the golden files again, after an intended change.
	PYTHONPATH=tests:$$PYTHONPATH $(BIN)/python tests/golden/generate.py

# Files of a source distribution all carry one old time, so that cargo takes what it built of them
# before for fresh: it is removed first. On Linux zig links against an old glibc, so that the wheel
# runs on robots with old systems, too; maturin checks that it does.
ifeq ($(shell uname -s),Linux)
wheel: export MATURIN_PEP517_ARGS := --zig --compatibility manylinux_2_28
endif
wheel: ## Build the source distribution and, from it, the wheel into dist/.
	rm -rf dist
	cargo clean --quiet --release $(OWN_CRATES)
	cargo clean --quiet --release $(OWN_CRATES) --target "$$(rustc -vV | sed -n 's/^host: //p')"
	CARGO_ZIGBUILD_ZIG_PATH="$$($(BIN)/python -c 'from importlib.util import find_spec as f; \
	    print(*(p + "/zig" for p in f("ziglang").submodule_search_locations))')" \
	    $(BIN)/python -m build --outdir dist

ci: ## Everything that has to pass, from a clean checkout.
	.ci/run

clean: ## Remove what the commands above made, except .venv.
	rm -rf target dist site runs docs/parameters.md docs/sensors.md $(TEST_VENV) $(OUSTER_VENV) $(PEERS_VENV) $(TRAINING_VENV) \
	    training/build training/*.egg-info python/lidar_core/*.so
