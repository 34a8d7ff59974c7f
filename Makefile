# Two commands for a newcomer: `make study` and `make test`. Each target makes its own environment in .venv when it is
# missing or older than what it is made from.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STUDY := $(VENV)/.study
READY := $(VENV)/.ready
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
OUT ?= results/study
ROUNDS ?= 15
ONLY ?=
# Own processes, a trajectory and its derivatives, ensembles, statistics, sensitivities.
FAST := $(addprefix tests/,package/test_fresh_process.py simulation/test_derivatives.py statistics/test_streaming.py \
	statistics/test_edges.py sensitivity/test_boundaries.py)
# What is cheap to measure: a tracer costs about a third more of the Python that runs, and hardly shows in compilations.
# Processes of their own are not seen.
MEASURED := $(filter-out tests/package/%,$(FAST)) $(addprefix tests/,numerics excitation package/test_bad_input.py \
	sensitivity/test_bad_input.py statistics/test_statistics.py statistics/test_stick_sums.py \
	statistics/test_labeled.py plot/test_trajectories.py plot/test_statistics.py study/test_sections.py \
	study/test_study.py)
SMOKE := benchmarks/.build/smoke

.PHONY: study test test-fast test-plain test-device bench-device test-wheel test-browser coverage check-slow docs docs-smoke site check-site notebooks mutations lint format bench bench-smoke versions clean

study: $(STUDY)
	$(BIN)/stickslip study --out $(OUT) --force

# A test that hangs is ended after ten minutes, and fails.
test: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal --timeout 600 --timeout-method thread

# What one runs while working: under a minute on two cores once the compilation cache is warm.
test-fast: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal tests/package/test_architecture.py $(FAST)

# The same without what the package asks of the compiler beyond jax.jit (docs/compiler.md): slower.
test-plain: export STICKSLIP_PLAIN_JAX = 1
test-plain: test-fast

# The quick tests on the device that JAX finds (docs/devices.md). On a CPU alone: in the layout for many lanes, without what
# only CPUs can do. FOLDERS="tests/ensemble" is some of them.
FOLDERS ?= tests
DEVICE = $$($(BIN)/python -c 'import jax; print(jax.devices()[0].platform)')
test-device: $(READY)
	@if test "$(DEVICE)" = cpu; then echo "There is no device but the CPU: the layout for many lanes is tried on it, with STICKSLIP_LANES=4096."; \
	else echo "On $$($(BIN)/python -c 'import jax; print(jax.devices()[0].device_kind)')."; fi
	test "$(DEVICE)" != cpu || export STICKSLIP_LANES=4096 STICKSLIP_PLAIN_JAX=1; \
		STICKSLIP_TESTED_DEVICE=1 $(BIN)/python -m pytest -n auto --dist worksteal $(FOLDERS)

# The wheel without extras, in an environment of its own: all public names, a call of each kind, every figure, and what
# each missing extra says. A few minutes.
test-wheel:
	$(PYTHON) tools/plain_wheel.py

# Pages in a browser. Installs nothing: without chromium, chromedriver or selenium it says what to do, and fails.
test-browser:
	@test -x $(BIN)/python || { echo "There is no $(VENV) yet: make test sets it up."; exit 1; }
	$(BIN)/python -m pytest -m browser tests/browser

# Lines and branches that the quick tests of all parts run; under two minutes once the compilation cache is warm.
coverage: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal --cov=stickslip_jax $(MEASURED)

# The fast part of the tests on the lowest versions that pyproject.toml allows, the pinned ones and the newest, on each
# with plain jax.jit too (docs/compiler.md); and with each set of the processor's instructions. WHICH="lowest" is one row.
WHICH ?=
versions:
	$(PYTHON) tools/versions.py $(WHICH) --tests $(FAST)

# Folder by folder, each in processes of its own: what JAX has compiled stays in memory, more than 10 GB of it in the end.
check-slow: $(READY)
	failed=; for folder in $$(grep -rl --include='test_*.py' 'mark\.slow' tests | cut -d/ -f1-2 | sort -u); do \
		$(BIN)/python -m pytest -m 'slow and not documents' -n auto --dist worksteal $$folder || failed="$$failed $$folder"; \
	done; test -z "$$failed" || { echo "failed:$$failed"; exit 1; }

# Each guard of the package is switched off in turn, and a test must fail. WHICH="programs LAPACK" is some of them.
mutations: $(READY)
	$(BIN)/python tools/mutations.py $(WHICH)

# The notebooks at full size, as .ipynb files with their figures.
notebooks: $(READY)
	$(BIN)/python tools/notebooks.py

# The site in results/docs, without running any code. Its notebooks show the last run of `make notebooks` (full size), or
# else of `make docs` (small), and each page says which; `make notebooks site` makes both.
site: $(READY)
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet --fresh-env docs results/docs

# All code in documents, docstrings and notebooks is run, these at a small size; then the site.
docs: export STICKSLIP_KEEP_NOTEBOOKS = $(CURDIR)/results/notebooks-small
docs: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal -m documents
	$(MAKE) site

# The same in small: the first pages, docstrings and one notebook, and the site, which says what was not run.
docs-smoke: export STICKSLIP_KEEP_NOTEBOOKS = $(CURDIR)/results/notebooks-small
docs-smoke: $(READY)
	$(BIN)/python -m pytest -n auto --dist worksteal -m 'documents and not slow'
	$(MAKE) site

# No block of code in the site is wider than its column, nothing is loaded from the net, and the search finds what it
# should; in a browser (chromium), which is asked for each page.
check-site: site
	$(BIN)/python tools/site_check.py results/docs

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The tables of the parts that were done are written even if a later one fails.
bench: $(READY)
	$(BIN)/python -m benchmarks --rounds $(ROUNDS) $(if $(ONLY),--only '$(ONLY)') || failed=1; \
		$(BIN)/python -m benchmarks.table && test -z "$$failed"

# Ensembles, statistics, sensitivities on the device that JAX finds; its rows go into benchmarks/README.md. Ten minutes.
bench-device: $(READY)
	$(BIN)/python -m benchmarks.device

# Every program of the benchmarks once, as small as possible, and the tables written into a copy.
bench-smoke: export JAX_COMPILATION_CACHE_DIR = $(CURDIR)/$(SMOKE)
bench-smoke: export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS = 0.1
bench-smoke: $(READY)
	mkdir -p benchmarks/.build
	cp benchmarks/README.md $(SMOKE).md
	$(BIN)/python -m benchmarks --tiny --rounds 1 --out $(SMOKE).json
	$(BIN)/python -m benchmarks.table $(SMOKE).json --into $(SMOKE).md
	STICKSLIP_LANES=1024 $(BIN)/python -m benchmarks.device --tiny --rounds 1 --into $(SMOKE).md

$(STUDY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed; set PYTHON=/path/to/python")'
	@echo "Making $(VENV), and installing the package and what studies need there: one or two minutes."
	$(PYTHON) -m venv --clear $(VENV)
	# Where a pinned version has no build for this Python, the lower bounds of pyproject.toml decide.
	$(PIP) -c constraints.txt -e '.[study]' || $(PIP) -e '.[study]'
	touch $@

$(READY): $(STUDY)
	@echo "Installing what tests, documents and benchmarks need as well: one to three minutes."
	$(PIP) -c constraints.txt -e '.[dev]' || $(PIP) -e '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) results build dist benchmarks/.build .pytest_cache .ruff_cache .hypothesis .benchmarks .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
