# `make help` lists the targets. `make train ARGS='seed=1 reward.progress.weight=15.0'` passes arguments on.

VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
PYTHON ?= python3.13 python3.12 python3.11 python3
ARGS ?=
# All but ray and rerun, which are large, mlflow and trackio, which want older packages than the rest.
EXTRAS := dev benchmark bound dataframes docs estimation examples export link maps minari notebook optuna px4 simulators slurm video wandb

# What `make readers` installs beside the lock file.
NODE_PACKAGES := @mcap/core@2.2.2 @mcap/support@1.1.0 protobufjs@8.8.1
RERUN := rerun-sdk==0.41.0

.PHONY: demo train reproduce baselines test test-long gpu readers docs check check-format check-lint check-types format lock clean help
.DEFAULT_GOAL := help

demo: $(STAMP) ## Fly the shipped policy through the default scene.
	$(PY) evaluate.py policy=policies/obstacles $(ARGS)

train: $(STAMP) ## Train a policy.
	$(PY) train.py $(ARGS)

reproduce: $(STAMP) ## Train the default policy anew and compare it with the stored runs.
	$(PY) train.py name=reproduce $(ARGS)
	$(PY) -m resc.evaluation.reproduction runs/latest_train

baselines: $(STAMP) ## Fly the policy and the planners it is compared with, and renew docs/results/baselines.
	for course in "paper null 8" "forest 100 1" "field 20 1" "gaps 20 1"; do set -- $$course; \
		$(PY) evaluate.py suite=$$1 maps=$$2 flights=$$3 \
			'pilot=[policy,ego_planner,fast_planner,mpc,pursuit]' 'pilot.ego_planner.tracking=[perfect,controller]' \
			'pilot.fast_planner.tracking=[perfect,controller]' recorder=none scene_files=0 name=baselines_$$1 $(ARGS) || exit 1; \
		mkdir -p docs/results/baselines/$$1; \
		cp runs/latest_evaluation/report.md runs/latest_evaluation/scenes.csv runs/latest_evaluation/together_*.png docs/results/baselines/$$1/; \
	done

test: $(STAMP) ## Run the tests that take seconds; ARGS='-m slow' for the others.
	$(PY) -m pytest -n auto --maxprocesses 4 --dist worksteal $(ARGS)

LONG := tests/envs/test_compiled.py::test_the_step_is_one_graph_and_another_difficulty_needs_no_other \
	tests/test_combinations.py::test_every_preset_flies_and_keeps_its_specs tests/envs/test_independence.py tests/studies/test_one_task.py \
	tests/test_mutations.py::test_dozens_of_wrong_settings_and_files_end_in_a_sentence_or_fly tests/test_waits.py \
	tests/test_wheel.py tests/deployment/test_export.py tests/test_examples.py tests/pages/test_browser.py tests/viewing/test_rerun_browser.py \
	tests/maps/test_ray_casting.py tests/test_compile_kernels.py tests/flying/test_replay.py tests/flying/test_pursuit.py \
	tests/evaluation/test_courses.py tests/learning/test_algorithms.py tests/simulation/test_px4.py tests/simulation/test_external.py \
	tests/baselines/test_pilot.py tests/flight_logs/test_identify.py tests/planning/test_time_optimal.py tests/terms/test_estimators.py \
	tests/terms/test_vehicle_errors.py

test-long: $(STAMP) ## Run the slow tests that CI runs, too: wheel, files of a policy, examples, pages in a browser, wrong settings, more cases of others.
	$(PY) -m pytest -n auto --maxprocesses 2 --dist worksteal -m slow $(LONG) $(ARGS)

gpu: $(STAMP) ## Check on a GPU what can only be checked there, and measure it: under five minutes.
	$(PY) -m pytest -q -m gpu
	$(PY) -m benchmarks.gpu

readers: $(STAMP) ## Install Rerun and the MCAP reader of web viewers (needs npm), read recordings with them.
	npm install --silent --no-audit --no-fund --prefix .cache/node $(NODE_PACKAGES)
	$(PY) -m pip install --quiet --disable-pip-version-check '$(RERUN)'
	NODE_PATH="$$PWD/.cache/node/node_modules" $(PY) -m pytest -rs tests/recording/test_conformance.py tests/viewing/test_rerun.py

docs: $(STAMP) ## Build the documentation's pages; a warning is an error.
	$(PY) -m docs.tools.build

check: check-format check-lint check-types ## Check format, lint and types.

check-format: $(STAMP)
	$(PY) -m ruff format --check .

check-lint: $(STAMP)
	$(PY) -m ruff check .

check-types: $(STAMP)
	$(PY) -m basedpyright

format: $(STAMP) ## Format the code.
	$(PY) -m ruff format .
	$(PY) -m ruff check --fix .

lock: ## Write requirements.lock anew from pyproject.toml (needs uv).
	@command -v uv >/dev/null || { echo "make lock needs uv on PATH; install it with: pip install uv" >&2; exit 1; }
	uv pip compile --quiet --universal --python-version 3.11 $(EXTRAS:%=--extra %) --generate-hashes \
		--no-emit-index-url --no-emit-find-links --no-header $(ARGS) --output-file requirements.lock pyproject.toml

clean: ## Remove caches and build products; .venv, runs and policies stay.
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .hypothesis .cache
	find . -path ./$(VENV) -prune -o -name __pycache__ -type d -exec rm -rf {} +

help: ## List the targets.
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 14

# torch.compile turns the step into C++, so a compiler and Python's headers belong to the requirements.
$(STAMP): requirements.lock
	@set -e; \
	fail() { echo "$$1" >&2; exit 1; }; \
	python=; \
	if ! $(PY) -m pip --version >/dev/null 2>&1; then \
		for name in $(PYTHON); do \
			if $$name -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then python=$$name; break; fi; \
		done; \
		test -n "$$python" || fail "No Python 3.11 or newer found; install one (Debian: apt install python3) or name it: make PYTHON=/path/to/python3."; \
		$$python -c 'import ensurepip, venv' 2>/dev/null || fail "$$python has no venv module; install it (Debian: apt install python3-venv)."; \
		$$python -c 'import os, sysconfig; open(os.path.join(sysconfig.get_path("include"), "Python.h"))' 2>/dev/null \
			|| fail "$$python has no Python.h, which torch.compile needs; install it (Debian: apt install python3-dev)."; \
	fi; \
	command -v "$${CXX:-g++}" >/dev/null || fail "No C++ compiler found, which torch.compile needs; install it (Debian: apt install g++) or name one: CXX=clang++."; \
	echo "Installing requirements.lock into $(VENV): about 3 minutes and 6 GB, since torch brings CUDA."; \
	test -z "$$python" || $$python -m venv --clear $(VENV); \
	$(PY) -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock; \
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .; \
	echo "Compiling kernels: about two minutes."; \
	$(PY) -c 'from resc.compile_kernels import compile_kernels; compile_kernels()'; \
	touch $@
