# make tune   install what is needed into .venv, then tune a learned car over its whole envelope (ARGS= passes more)
# make test   install the extras too (torch among them), then run every test but those that need a kernel with CAN,
#             a PostgreSQL server, a C compiler, or long compiling, training or calibrating, and the slow ones of
#             tools/ (.ci/run runs them)
# make check  format, lint, types, fast tests
# make venv   install only, and compile the simulated cars of BENCH

PYTHON ?= python3
BENCH ?= bench_configs/mkz_envelope.toml
ARGS ?=
PIP = .venv/bin/python -m pip --disable-pip-version-check --quiet --quiet

COMPILED = .venv/.compiled-$(subst /,-,$(BENCH))

.PHONY: help tune test check venv test-venv
.DEFAULT_GOAL := help

help:
	@sed -n 's/^# make/make/p' Makefile

tune: venv
	@.venv/bin/tunefree-hil tune $(BENCH) $(ARGS)

test: test-venv
	@.venv/bin/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder -m "not compiled and not vcan and not postgres and not foreign and not learning and not tooling" $(ARGS)

check: test-venv
	@tools/check

venv: .venv/.installed $(COMPILED)
test-venv: .venv/.installed-test

# A stamp is written when all of its lock is installed; a changed lock installs again.
.venv/.installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "Python 3.11 or newer is needed: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "python3-venv is missing: apt-get install python3-venv" >&2; exit 2; }
	@.venv/bin/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear .venv
	@echo "installing into .venv (about half a minute) ..."
	@$(PIP) install -r requirements.lock
	@$(PIP) install --no-build-isolation --no-deps --editable .
	@touch $@

# Only a wait is saved by it: where it fails, whatever needs the machine code compiles it or says why not.
$(COMPILED): .venv/.installed
	@echo "compiling the simulated cars (about half a minute) ..."
	@.venv/bin/python tools/precompile.py $(BENCH) || true
	@touch $@

.venv/.installed-test: requirements-test.lock .venv/.installed
	@echo "installing torch and the test tools into .venv (about half a minute) ..."
	@$(PIP) install -r requirements-test.lock
	@touch $@
