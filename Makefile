# `make` lists what there is. Everything runs from a fresh clone; nothing is needed that the list
# does not name.

SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-builtin-rules

# Packages that are built together. The bindings are built by maturin only, since they must not link Python. The package
# `workspace-hack` gives crates that both share one set of features, so that cargo builds them once.
RUST := --workspace --exclude trocar-py --locked

PYTHON ?= python3
CARGO ?= cargo
TARGET := $(abspath $(or $(CARGO_TARGET_DIR),target))

# Python tools and the package itself, from a lock file with hashes.
VENV := .venv
BIN := $(abspath $(VENV)/bin)
# The oldest supported Gymnasium and both wheels, as a user has them: no source tree, no Rust.
WHEEL_VENV := .venv-wheels
WHEEL_BIN := $(abspath $(WHEEL_VENV)/bin)
# What plots need.
PLOT_VENV := .venv-plot
# With the wheels, what depends on Gymnasium and on how the package is installed. Tasks that grasp or handle tissue are left
# out: what they add takes long and is neither's.
WHEEL_TESTS := $(addprefix tests/test_,$(addsuffix .py,conventions env front_door goals package reset_options seeds vector)) \
	-k "not stubs" -m "not grasp and not tissue"
# Python files under ruff, as seen from client-py/, whose pyproject.toml has the rules.
PYTHON_CODE := . ../tests/prose.py ../tests/vocabulary.py ../tests/documents.py ../tests/notices.py ../tests/wheels.py ../server/cli/src/demo ../server/cli/src/bench ../server/cli/src/load ../server/view/tests ../tests/ros2 ../tests/mujoco_twin
# What people train with, each with the Gymnasium that it needs.
RL_BIN := $(abspath .venv-rl/bin)
MUJOCO_BIN := $(abspath .venv-mujoco/bin)
RLLIB_BIN := $(abspath .venv-rllib/bin)
RL_TEST := TROCAR_BINARY=$(TARGET)/debug/trocar
# Builds the bindings where the sources are, for every virtual environment that has a path to them. Installing the
# package would fetch trocar-server, on which it depends and which this tree builds itself.
DEVELOP := cd client-py && VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/maturin develop --quiet --skip-install --locked
LINK = echo $(CURDIR)/client-py/python > $$($(@D)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/trocar.pth
PIP_INSTALL := -m pip install --quiet --disable-pip-version-check

.PHONY: help
help:
	@echo 'Needs for everything: Linux, Rust >= 1.95 (cargo), a C linker, make.'
	@echo 'Those marked * also need Python >= 3.10 with venv, and a package index for pip.'
	@grep -E '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):.*## (.*)/  make \1\t\2/' | expand -t 18

# ---- Running ----

.PHONY: demo
demo: $(VENV)/ready ## * one server, a Rust and two Python clients at once; a table, target/demo.gif and target/tasks.png
	$(CARGO) build --release --locked -p trocar
	$(DEVELOP) --release
	$(TARGET)/release/trocar demo --python $(BIN)/python --out $(TARGET)/demo.gif
	$(TARGET)/release/trocar render --out $(TARGET)/tasks.png

# Also what `every_task_looks_as_it_did` expects.
.PHONY: pictures
pictures: ## assets/pictures: every task, also in both looks; films of experts; every policy at work
	$(CARGO) build --release --locked -p trocar
	$(TARGET)/release/trocar render --each assets/pictures
	$(TARGET)/release/trocar render --task NeedlePick-v0 --out assets/pictures/needle_pick.gif
	for task in TissueRetract TissuePoint GauzePlace; do \
		$(TARGET)/release/trocar render --task $$task-v0 --look cavity --camera endoscope --seed 0 --size 240x180 \
			--out assets/pictures/$$task-v0.gif; \
	done
	for look in bench cavity; do \
		$(TARGET)/release/trocar render --look $$look --camera endoscope --moments 2 --size 160x120 \
			--out assets/pictures/$$look.png; \
	done
	for policy in assets/policies/*.onnx; do \
		name=$$(basename $$policy .onnx); \
		$(TARGET)/release/trocar render --policy $$policy --seed 0 --seconds 8 --fps 5 --size 160x120 \
			--out assets/policies/$$name.gif; \
	done

# Those that are in the program and in assets/policies: of each task's runs in RUNS, the policy with the best score.
RUNS ?= runs
.PHONY: policies
policies: .venv-rl/ready ## * assets/policies: the best policies of the runs in RUNS, which were evaluated, as ONNX with cards
	$(RL_BIN)/python -m trocar.rl best --trust $(RUNS) --out assets/policies

# What `experts_do_as_well_as_the_table_says_and_stay_in_bounds` expects.
# TROCAR_TASK=NeedlePick-v0: only its rows.
.PHONY: experts
experts: ## server/tests/fixtures/experts.tsv: with which seeds the scripted experts fail
	TROCAR_WRITE_EXPERTS=1 $(CARGO) test $(RUST) --test server experts::

.PHONY: picture-arm-errors
picture-arm-errors: ## assets/pictures/arm_errors.svg: what joints with the errors of real arms are told, report and do
	TROCAR_WRITE_PICTURE=1 $(CARGO) test $(RUST) --test server arm_errors::lags

.PHONY: picture-viewer
picture-viewer: $(VENV)/ready ## * assets/pictures/viewer.png: the live viewer, as test-browser sees it
	$(CARGO) build --release --locked -p trocar
	TROCAR_BINARY=$(TARGET)/release/trocar $(BIN)/python server/view/tests/test_viewer.py assets/pictures/viewer.png

.PHONY: picture-frames
picture-frames: develop $(PLOT_VENV)/ready ## * assets/pictures/frames.png: which frames dVRK scripts are about
	TROCAR_BINARY=$(TARGET)/debug/trocar $(PLOT_VENV)/bin/python client-py/examples/dvrk_frames.py assets/pictures/frames.png

# What it is built from has its hash in page.sha256, so that a build sees without Node whether it is stale.
.PHONY: viewer
viewer: ## server/view/page.html: builds the page of the live viewer anew; needs Node >= 20 with npm
	cd server/view && npm ci --ignore-scripts --no-audit --no-fund && node build.mjs
	cd server/view && LC_ALL=C sha256sum build.mjs package.json package-lock.json src/* page.html > page.sha256

# The oldest glibc that Rust's standard library works with. Without zig, the linker takes the machine's own version.
GLIBC := manylinux2014
RELEASE_WHEEL := PATH=$(abspath .venv-zig/bin):$$PATH .venv-zig/bin/maturin build --release --locked --strip --zig \
	--compatibility $(GLIBC) --out dist

.PHONY: wheels
wheels: .venv-zig/ready ## * dist/: the wheels trocar (client) and trocar-server (the program), for glibc 2.17 or newer
	rm -rf dist
	$(PYTHON) tests/notices.py write
	$(RELEASE_WHEEL) --manifest-path client-py/Cargo.toml
	$(RELEASE_WHEEL) --manifest-path server/cli/Cargo.toml
	$(PYTHON) tests/notices.py check dist/*.whl
	$(PYTHON) tests/wheels.py dist/*.whl

# SEEDS=0..40: which episodes; the table in server/GRASPING.md is that of its own seeds.
.PHONY: experts-table
experts-table: ## how often the scripted experts succeed with arms that are late, disturbed or wrong
	$(CARGO) run --release --locked -p trocar-server --example experts -- --threads $$(nproc) --seeds $${SEEDS:-0..40}

# TROCAR_BITS=starts: only the episodes whose start is the expert's work; =tasks: only those of tasks that are new;
# =tissue: those of tasks with tissue.
.PHONY: bits
bits: ## server/tests/fixtures/bits.bin: records its episodes anew; only when physics changes on purpose
	TROCAR_BITS=$${TROCAR_BITS:-all} $(CARGO) test $(RUST) --test server -- --ignored --exact bits::write_the_file

# ---- Checking ----

.PHONY: test
test: stage-lint ## * all that CI runs: lints, Rust, Python, wheels; test-faults where strace is
	@# Cargo builds the bindings once the first tests run, which wait most of the time: until then it waits for their build.
	@$(MAKE) stage-test-rust & tests=$$!; nice $(MAKE) stage-bindings || failed=yes; wait $$tests && [ -z "$${failed:-}" ]
	@$(MAKE) stage-test-loom stage-test-python
	@command -v strace > /dev/null || echo 'left out: test-faults needs strace (apt install strace)'
	@$(MAKE) --jobs=2 --output-sync=target stage-test-wheels $$(command -v strace > /dev/null && echo stage-test-faults)

# Another target, whose seconds are appended to the file $STAGE_TIMES, if that variable is set.
stage-%:
	@tests/stage $* $(MAKE) $*

# Leaves out what takes minutes: experts over many seeds, adversaries, killed processes, packages.
FAST_SKIP := $(foreach name,bits:: experts:: robustness:: render:: grasp:: nothing_explodes every_option,--skip $(name))
FAST_PYTHON := $(addprefix tests/test_,$(addsuffix .py,arrays conventions env errors features goals package seeds))

.PHONY: test-fast
test-fast: lint-prose develop ## * the inner loop: unit tests, the suite and clients, in three minutes once all is built
	$(CARGO) test $(RUST) --lib --bins
	$(CARGO) test $(RUST) --test server -- $(FAST_SKIP)
	TROCAR_BINARY=$(TARGET)/debug/trocar $(CARGO) test $(RUST) --test trocar -- conformance:: parity:: rows:: refusals::
	cd client-py && TROCAR_BINARY=$(TARGET)/debug/trocar $(BIN)/python -m pytest -q $(FAST_PYTHON)

.PHONY: lint
lint: lint-rust lint-python lint-viewer lint-prose ## * formatting, clippy, ruff, generated assets, prose

.PHONY: lint-rust
lint-rust:
	$(CARGO) fmt --all --check
	$(CARGO) clippy --workspace --all-targets --locked -- -D warnings
	RUSTDOCFLAGS="-D warnings -A rustdoc::private_intra_doc_links -A rustdoc::redundant_explicit_links" $(CARGO) doc --workspace --no-deps --document-private-items --locked

.PHONY: lint-python
lint-python: $(VENV)/ready
	$(PYTHON) assets/generate.py --check
	cd client-py && $(BIN)/ruff check $(PYTHON_CODE) && $(BIN)/ruff format --check $(PYTHON_CODE)

.PHONY: lint-viewer
lint-viewer:
	cd server/view && sha256sum --check --quiet page.sha256 || { echo 'page.html is stale: run `make viewer`'; exit 1; }

.PHONY: lint-prose
lint-prose:
	$(PYTHON) tests/prose.py
	$(PYTHON) tests/vocabulary.py
	$(PYTHON) tests/documents.py

.PHONY: test-rust
test-rust: ## Rust: unit, task suite, command, multi-process (reduced counts)
	TROCAR_BINARY=$(TARGET)/debug/trocar $(CARGO) test $(RUST)

.PHONY: test-loom
test-loom: ## every order in which threads can wake each other up, by loom: no wake-up is lost
	$(CARGO) test $(RUST) --features trocar-proto/loom --test loom

# Every 17th call; in `make soak` all of them.
.PHONY: test-faults
test-faults: ## calls of the kernel fail, one after the other, by strace, which it needs (apt install strace)
	$(CARGO) build $(RUST) --bin trocar
	TROCAR_BINARY=$(TARGET)/debug/trocar $(CARGO) test $(RUST) --test trocar -- --ignored --nocapture faults::

.PHONY: test-python
test-python: develop ## * Python with the newest Gymnasium: types, stubs, tests
	cd client-py && $(BIN)/mypy && $(BIN)/mypy ../tests/prose.py ../tests/vocabulary.py ../tests/documents.py ../tests/notices.py ../tests/wheels.py && for worker in demo bench load; do $(BIN)/mypy ../server/cli/src/$$worker/worker.py; done
	cd client-py && MYPYPATH=python:../tests $(BIN)/mypy ../tests/mujoco_twin/*.py
	cd client-py && TROCAR_BINARY=$(TARGET)/debug/trocar $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist worksteal
	TROCAR_PYTHON=$(BIN)/python $(CARGO) test $(RUST) --test load python_clients

.PHONY: test-wheels
test-wheels: $(VENV)/ready ## * both wheels with the oldest Gymnasium, without Rust on the PATH
	rm -rf $(TARGET)/test-wheels
	$(PYTHON) tests/notices.py write
	$(BIN)/maturin build --profile dev --locked --manifest-path client-py/Cargo.toml --out $(TARGET)/test-wheels
	$(BIN)/maturin build --profile dev --locked --manifest-path server/cli/Cargo.toml --out $(TARGET)/test-wheels
	$(PYTHON) tests/notices.py check $(TARGET)/test-wheels/*.whl
	$(PYTHON) -m venv --clear $(WHEEL_VENV)
	$(WHEEL_BIN)/python $(PIP_INSTALL) --require-hashes -r client-py/requirements-oldest.lock
	$(WHEEL_BIN)/python $(PIP_INSTALL) --no-index --find-links $(TARGET)/test-wheels trocar
	cd / && PATH=$(WHEEL_BIN) trocar --version
	cd / && PATH=$(WHEEL_BIN) python $(CURDIR)/client-py/examples/random_policy.py
	cd client-py && PATH=$(WHEEL_BIN):/usr/bin:/bin python -m pytest $(WHEEL_TESTS)

# Where Node is, also whether the page is what its sources give.
.PHONY: test-browser
test-browser: lint-viewer $(VENV)/ready ## * the live viewer in a headless Chromium, which it needs (apt install chromium)
	$(CARGO) build $(RUST) --bin trocar
	if command -v npm; then cd server/view && npm ci --ignore-scripts --no-audit --no-fund && node build.mjs --check; fi
	cd client-py && $(BIN)/mypy ../server/view/tests/*.py
	cd client-py && TROCAR_BINARY=$(TARGET)/debug/trocar timeout --signal=INT 900 $(BIN)/python -m pytest -c pyproject.toml ../server/view/tests

.PHONY: test-mujoco
test-mujoco: develop .venv-mujoco/ready ## * the twin in another engine against closed forms, its arm against dVRK's
	cd client-py && TROCAR_BINARY=$(TARGET)/debug/trocar $(MUJOCO_BIN)/python -m pytest -c pyproject.toml ../tests/mujoco_twin

# In a network of its own, where nothing else is found and nothing gets out.
.PHONY: test-ros2
test-ros2: develop ## * `trocar dvrk` against rclpy over ROS 2; needs Python 3.11, C++, unshare, ip; 400 MB of packages
	PYTHON=$(PYTHON) TARGET=$(TARGET) CARGO="$(CARGO)" RUST="$(RUST)" tests/ros2/run

.PHONY: test-rl
test-rl: develop .venv-rl/ready .venv-rllib/ready ## * SB3, TorchRL, CleanRL, RLlib: tests, examples; fetches 5 GB
	cd client-py && $(RL_BIN)/mypy python/trocar/{sb3,_sb3_export}.py python/trocar/{demos,rl}/*.py tests/rl/test_{pages,sb3,demos,algorithms,curriculum,training,features,episodes,own}.py examples/her_needle_reach.py examples/parts.py examples/worker_processes.py
	cd client-py && $(RL_TEST) $(RL_BIN)/python -m pytest -W ignore::DeprecationWarning tests/rl python/trocar/sb3.py
	cd client-py && $(RL_TEST) $(RL_BIN)/python examples/her_needle_reach.py --steps 3000 --out $(TARGET)/her_needle_reach
	cd client-py && $(RL_TEST) $(RL_BIN)/python examples/parts.py
	cd client-py && $(RL_TEST) $(RL_BIN)/python examples/worker_processes.py --steps 2048
	cd client-py && $(RL_TEST) $(RL_BIN)/python examples/torchrl_ppo.py --steps 4000
	cd client-py && $(RL_TEST) $(RL_BIN)/python examples/cleanrl_ppo.py --steps 4000
	cd client-py && $(RL_TEST) $(RLLIB_BIN)/python -m pytest tests/rllib
	cd client-py && $(RL_TEST) $(RLLIB_BIN)/python examples/rllib_ppo.py --iterations 2

# Locks, then server, client and shared memory in one process.
.PHONY: test-valgrind
test-valgrind: ## memory errors of server, client and shared memory, by valgrind, which it needs (apt install valgrind)
	$(CARGO) test --locked -p trocar-proto -p trocar-tests --no-run
	export CARGO_TARGET_X86_64_UNKNOWN_LINUX_GNU_RUNNER="valgrind --error-exitcode=9 --fair-sched=yes"; \
	$(CARGO) test --locked -p trocar-proto --lib endpoint; \
	$(CARGO) test --locked -p trocar-tests --test allocations

# Coverage of the code here and of what it depends on, but not of what runs while it is built: hence --target.
FUZZ_HOST = $(shell rustc -vV | sed -n 's/^host: //p')
FUZZ_FLAGS := -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
	-Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
	-Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing -Ccodegen-units=1
# What computes a policy's matrices takes ten minutes to compile with both counters and optimisation.
FUZZ_SLOW := --config 'profile.dev.package.rten-gemm.opt-level=1'
FUZZ_TARGET ?= control data live words snapshots recordings urdf policies options
FUZZ_S ?= 600

# FUZZ_S=3600 FUZZ_TARGET=urdf: for how long, and what. Inputs that are found stay in target/fuzz for the next time.
.PHONY: fuzz
fuzz: ## coverage-guided fuzzing of all that is read from others, ten minutes each; needs g++
	$(CARGO) build $(RUST) --bin corpus
	RUSTFLAGS="$(FUZZ_FLAGS)" $(CARGO) build $(FUZZ_SLOW) --locked -p trocar-fuzz --bin fuzz --features libfuzzer \
		--target $(FUZZ_HOST)
	FUZZ_BIN=$(TARGET)/$(FUZZ_HOST)/debug/fuzz CORPUS_BIN=$(TARGET)/debug/corpus FUZZ_DIR=$(TARGET)/fuzz \
		FUZZ_S="$(FUZZ_S)" FUZZ_TARGET="$(FUZZ_TARGET)" tests/fuzz/run

.PHONY: fuzz-corpus
fuzz-corpus: ## the same, and keeps in tests/fuzz/corpus the fewest inputs that have all of the coverage
	FUZZ_MERGE=yes $(MAKE) fuzz

.PHONY: soak
soak: develop ## * the long bars: 1,000,000 fuzzed messages, long multi-process loops, every failing call; needs strace
	TROCAR_SOAK=1 TROCAR_BINARY=$(TARGET)/debug/trocar $(CARGO) test $(RUST) -- --nocapture
	TROCAR_SOAK=1 $(MAKE) test-faults
	TROCAR_SOAK=1 TIMEOUT=1800 $(MAKE) test-ros2

.PHONY: bench
bench: develop ## * all steps per second (trocar bench); criterion: kinematics, steps, snapshots, a round trip
	$(CARGO) build --release --locked -p trocar
	$(DEVELOP) --release
	TROCAR_PYTHON=$(BIN)/python $(TARGET)/release/trocar bench
	$(CARGO) bench $(RUST)

# The benchmarks in Python, with all that is compiled in the release profile.
.PHONY: release
release: $(VENV)/ready
	$(CARGO) build --release --locked -p trocar
	$(CARGO) build --release --locked -p trocar-server --example in_process
	$(DEVELOP) --release

.PHONY: bench-dvrk
bench-dvrk: release ## * a dVRK script that servoes at 100 Hz in lock-step: how many times faster than life, on one core
	taskset --cpu-list 0 $(CARGO) bench --locked -p trocar-tests --bench live
	TROCAR_BINARY=$(TARGET)/release/trocar taskset --cpu-list 0 $(BIN)/python client-py/benches/servo.py

.PHONY: bench-async
bench-async: release ## * 64 environments: a session against Gymnasium's AsyncVectorEnv, in turns
	TROCAR_BINARY=$(TARGET)/release/trocar $(BIN)/python client-py/benches/async_vector_env.py \
		--simulation $(TARGET)/release/examples/libin_process.so

.PHONY: bench-soft
bench-soft: .venv-mujoco/ready ## * a slab of tissue: this simulation against rapier's soft bodies and MuJoCo's, in turns
	bench=$$($(CARGO) bench --locked -p trocar-server --bench soft --no-run --message-format=json | \
		sed -nE 's/.*"executable":"([^"]*soft-[^"]*)".*/\1/p' | tail -n 1); \
	taskset --cpu-list 0 $(MUJOCO_BIN)/python client-py/benches/soft_slab.py "$$bench"

# What draws pictures is compared with in PyBullet.
.PHONY: bench-tiny-renderer
bench-tiny-renderer: .venv-bullet/ready ## * a picture of NeedlePick: this renderer against PyBullet's, in turns
	$(CARGO) build --release --locked -p trocar-server --example in_process
	.venv-bullet/bin/python client-py/benches/tiny_renderer.py --simulation $(TARGET)/release/examples/libin_process.so

# Server and clients share one core, so that what is compared is the work of one.
.PHONY: bench-plot
bench-plot: release $(PLOT_VENV)/ready ## * assets/pictures/throughput.png: rates against envs and clients
	mkdir -p assets/pictures
	export TROCAR_PYTHON=$(BIN)/python; \
	for round in 1 2 3; do for task in EcmReach-v0 NeedlePick-v0; do \
		bench="taskset --cpu-list 0 $(TARGET)/release/trocar bench --quick --json --policy random --task $$task"; \
		$$bench --envs 16,64,256,1024,4096; \
		$$bench --envs 16 --clients 1,2,4,8,16,32,64 --mode in_process,client_rs; \
	done; done > $(TARGET)/throughput.jsonl
	$(PLOT_VENV)/bin/python client-py/benches/plot_throughput.py assets/pictures/throughput.png \
		< $(TARGET)/throughput.jsonl

# CORES="1 2 4 8 16": with how many threads; all those of the machine should be idle.
.PHONY: bench-cores
bench-cores: $(PLOT_VENV)/ready ## * assets/pictures/cores.png: one session of 256 environments on more and more threads
	$(CARGO) build --release --locked -p trocar
	for round in 1 2 3; do for task in NeedlePick-v0 BiPegTransfer-v0; do for threads in $${CORES:-1 2}; do \
		$(TARGET)/release/trocar bench --quick --json --mode client_rs --policy oracle --envs 256 --task $$task --threads $$threads; \
	done; done; done > $(TARGET)/cores.jsonl
	$(PLOT_VENV)/bin/python client-py/benches/plot_cores.py assets/pictures/cores.png < $(TARGET)/cores.jsonl

# ---- Keeping house ----

.PHONY: fmt
fmt: $(VENV)/ready ## * formats Rust and Python
	$(CARGO) fmt --all
	cd client-py && $(BIN)/ruff check --fix $(PYTHON_CODE) && $(BIN)/ruff format $(PYTHON_CODE)

.PHONY: clean
clean: ## removes all that the targets above made
	$(CARGO) clean
	rm -rf $(VENV) $(WHEEL_VENV) $(PLOT_VENV) .venv-rl .venv-rllib .venv-bullet .venv-mujoco .venv-ros2 .venv-zig dist client-py/python/trocar/*.so server/view/node_modules
	rm -f {client-py,server/cli}/{LICENSE,THIRD_PARTY_NOTICES}

# The program, the example of an own task and the Python package of this tree, in the profile that tests use.
.PHONY: develop
develop: $(VENV)/ready
	$(CARGO) build $(RUST) --bin trocar --example own_task
	$(DEVELOP)

.PHONY: bindings
bindings: $(VENV)/ready
	$(DEVELOP)

$(PLOT_VENV)/ready: client-py/requirements-bench.lock
	$(PYTHON) -m venv --clear $(PLOT_VENV)
	$(PLOT_VENV)/bin/python $(PIP_INSTALL) --require-hashes -r $<
	$(LINK)
	touch $@

$(VENV)/ready: client-py/requirements-dev.lock
	$(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/python $(PIP_INSTALL) --require-hashes -r $<
	$(LINK)
	touch $@

# Without dependencies: the lock files have all of them, less what torch needs on a GPU only.
.venv-%/ready: client-py/requirements-%.lock
	$(PYTHON) -m venv --clear $(@D)
	$(@D)/bin/python $(PIP_INSTALL) --require-hashes --no-deps -r $<
	$(LINK)
	touch $@
