# Two commands do it all: `make demo` and `make test`. They create .venv and install what they need.
# PYTHON=... chooses the interpreter (3.11 or newer); otherwise the first that fits is taken.
# CONSTRAINTS= takes the newest versions instead of those that were tested together.
# HASHES=.ci/hashes.txt installs the development tools from files with these hashes alone, as CI does.

VENV := .venv
BIN := $(VENV)/bin
NEEDED := import sys; sys.exit(sys.version_info < (3, 11))
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python3.14; do \
	"$$p" -c '$(NEEDED)' 2>/dev/null && { echo "$$p"; break; }; done)

unexport PYTHONDONTWRITEBYTECODE  # without bytecode each of a thousand starts of the tests compiles all sources anew
unexport PYTHONUNBUFFERED  # a user's output has a buffer

# no test writes there: they have a copy
test: export COULOMBUS_TEST_WARM_UP := $(or $(NUMBA_CACHE_DIR),$(CURDIR)/out/warm-up)
# its threads wait busily for a processor that another test has
test fast long: export OPENBLAS_NUM_THREADS := 1

.PHONY: demo test fast long check docs bench wheel constraints clean help
.DEFAULT_GOAL := demo

help:  ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## */  make \1\t/' | expand -t 18

demo: $(VENV)/.run  ## the paper's experiment on the built-in virtual bus
	@$(BIN)/coulombus warm-up --for run && $(BIN)/coulombus demo

test: $(VENV)/.dev  ## the tests: those against the wall clock, and beside them those in virtual time
	@PYTHON=$(BIN)/python scripts/test

fast: $(VENV)/.dev  ## a minute of tests in plain Python: what decides about torque, brake and arming
	@NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest -q -n auto --maxprocesses 4 --durations=3 \
	-m "not real_time and not slow and not thorough and not long" $$($(BIN)/python scripts/mutate.py --tests)

wheel: $(VENV)/.dev  ## build the wheel, install it somewhere else, and run it there
	@scripts/try-wheel

check: $(VENV)/.dev  ## lint, format, types, import contracts, words
	@scripts/check

docs: $(VENV)/.docs  ## the site of the documents, in out/site; fails on a warning
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict  # --quiet would count no warning
	@echo "built without a warning: out/site/index.html"

bench: $(VENV)/.dev  ## the figures of speed, as ratios
	@$(BIN)/python -m benchmarks

CONSTRAINTS ?= constraints.txt
comma := ,
PIP := $(BIN)/python -m pip install --disable-pip-version-check
# installs what $(1) says in the versions that were tested together; where not all of them can be had, the newest
define install
$(PIP) $(addprefix --constraint ,$(CONSTRAINTS)) $(1) || { test -n "$(CONSTRAINTS)" && \
echo "make: not all versions of $(CONSTRAINTS) can be had; taking the newest ones" >&2 && $(PIP) $(1); }
endef
hashed = $(PIP) --quiet --no-compile --require-hashes --no-deps --requirement $(HASHES) && \
	$(PIP) --quiet --no-deps --no-build-isolation --editable .

$(VENV)/.made:  # written when all is there: what was interrupted is begun anew, and what works is kept
	@test ! -f coulombus/node || { echo "make: coulombus/node is no link to node/: this copy was unpacked without symbolic links (a zip archive); clone it with git" >&2; exit 1; }
	@test -n "$(PYTHON)" || { echo "make: Python 3.11 or newer is needed; name one with PYTHON=/path/to/python3.11" >&2; exit 1; }
	@"$(PYTHON)" -c '$(NEEDED)' || { echo "make: $(PYTHON) is older than 3.11" >&2; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || { \
		echo "creating $(VENV) with $$("$(PYTHON)" --version)"; \
		"$(PYTHON)" -m venv --clear $(VENV) || { \
		if "$(PYTHON)" -c 'import venv, ensurepip' 2>/dev/null; \
		then echo "make: cannot write $(VENV) in $(CURDIR): the folder must be yours to write, with 1 GB free" >&2; \
		else echo "make: cannot create a virtual environment (Debian: apt install python3-venv)" >&2; fi; exit 1; }; }
	@touch $@

# installs what runs, and begins to compile it with the settings $(1) and the options $(2): meanwhile the rest is installed
define begin_to_compile
@$(BIN)/python -c 'import tomllib; \
wanted = tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]; \
print(*(one for one in wanted if not one.startswith(("cantools", "matplotlib", "scipy"))), sep="\n")' >$(VENV)/first.txt
@$(call install,--no-compile --requirement $(VENV)/first.txt)
@$(1) $(BIN)/python -m coulombus warm-up $(2) >/dev/null 2>&1 </dev/null &
endef

$(VENV)/.run: pyproject.toml $(wildcard $(CONSTRAINTS)) | $(VENV)/.made
	@echo "installing (once), half a minute ..."
	$(call begin_to_compile,,--for run)
	@$(call install,--no-compile --editable '.[web]')
	@touch $@

$(VENV)/.dev: pyproject.toml $(wildcard $(CONSTRAINTS)) | $(VENV)/.made
	@echo "installing with the development tools (once), a minute ..."
	$(if $(HASHES),,$(if $(COULOMBUS_TEST_WARM_UP),$(call begin_to_compile,NUMBA_CACHE_DIR=$(COULOMBUS_TEST_WARM_UP))))
	@$(if $(HASHES),$(hashed),$(call install,--quiet --no-compile --editable '.[dev$(comma)docs]'))
	@touch $@ $(VENV)/.run $(VENV)/.docs

$(VENV)/.docs: pyproject.toml | $(VENV)/.made
	@echo "installing what builds the site (once) ..."
	@$(call install,--quiet --editable '.[docs]')
	@touch $@ $(VENV)/.run

long: $(VENV)/.dev  ## what takes an hour: every mutant, a million frames against the bits, an afternoon of cycles
	@$(BIN)/python -m pytest -q --durations=0 -m "(long or thorough) and not real_time" -n auto --maxprocesses 4
	@$(BIN)/python -m pytest -q --durations=0 -m "(long or thorough) and real_time"
	@$(BIN)/python scripts/mutate.py
	@$(BIN)/python scripts/mutate_drawn.py 100 --map --seed $$(date +%G%V)  # others each week
	@$(BIN)/python -m benchmarks bits
	@$(BIN)/python -m benchmarks loss --minutes 30
	@$(BIN)/python -m benchmarks.explain truths --runs 2000
	@$(BIN)/python -m benchmarks observers --observers 1000
	@$(BIN)/python -m benchmarks observers --displays --observers 100
	@$(BIN)/python -m benchmarks observers --groups 200
	@$(BIN)/python -m benchmarks coverage --rigs 200

constraints: $(VENV)/.made  ## name the newest versions as those that are tested together; run make test behind it
	@rm -rf out/newest && $(BIN)/python -m venv out/newest
	@out/newest/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@{ echo "# What was tested together, renewed by make constraints. CONSTRAINTS= of make takes the newest."; \
	out/newest/bin/python -m pip freeze --exclude-editable; } >constraints.txt
	@out/newest/bin/python -m pip install --quiet --disable-pip-version-check uv
	@echo "setuptools>=77" | out/newest/bin/uv pip compile --quiet pyproject.toml - --extra dev --extra docs --constraint constraints.txt \
	--universal --python-version 3.11 --generate-hashes --no-header --no-annotate --output-file .ci/hashes.txt
	@rm -rf out/newest

clean:  ## remove what was made here
	rm -rf $(VENV) out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
