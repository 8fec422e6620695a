# Every target sets up .venv by itself; ARGS is passed on: make test ARGS="-k robot -x"
RUN := tools/bootstrap.sh
ARGS :=

.PHONY: help venv docs paper test test-long test-oldest test-slow test-blind demo bench figures lint format live
.SILENT:
# What pytest and its plugins compile is kept, whatever this machine's settings are: each process of
# tests would else take a second for it, and conftest.py comes too late.
unexport PYTHONDONTWRITEBYTECODE

help: ## list the targets
	grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

venv: ## set up .venv and nothing else
	$(RUN)

live: ## watch a mock robot meet its model, find what it hides: ARGS="--headless --hidden NAME"
	$(RUN) python -m tendon_robot_ros live $(ARGS)

# Four more than the cores that it is meant for: nodes wait most of the time. conftest.py puts the
# longest files first, so that what is left at the end is short.
SPREAD := -n 6 --dist loadfile --no-loadscope-reorder

test: ## the fast tests
	$(RUN) python -m pytest $(SPREAD) $(ARGS)

test-long: ## tests that take seconds each: diagnoses, whole commands, arms that move (minutes)
	$(RUN) python -m pytest -m "long and not slow" $(SPREAD) $(ARGS)

test-oldest: ## the same with the oldest numpy, scipy and numba that setup.py allows
	VENV="$(CURDIR)/.venv-oldest" PIP_CONSTRAINT=tools/oldest.txt \
		$(RUN) python -m pytest $(SPREAD) $(ARGS)

test-slow: ## tests that take minutes
	$(RUN) python -m pytest -m slow $(SPREAD) $(ARGS)

test-blind: ## diagnoses of robots with a hidden effect, and what was said of each (minutes)
	$(RUN) python -m pytest -m blind $(ARGS)

demo: ## the paper's postures with a mock arm, in under a minute
	$(RUN) python -m tendon_robot_ros demo $(ARGS)

paper: ## the paper's experiments: published numbers beside ours (results/paper)
	$(RUN) python -m tendon_robot_ros study paper --output results/paper --overwrite $(ARGS)

# Sphinx is added to .venv the first time. Any warning is an error: a link that leads nowhere is one.
docs: ## the documentation as a site with search and API (results/docs/index.html)
	$(RUN) sh -c 'python -c "import furo, myst_parser, numpydoc" 2>/dev/null || \
		python -m pip install --disable-pip-version-check -q -e ".[docs]"'
	$(RUN) python -m sphinx -q -W --keep-going docs results/docs $(ARGS)

BENCH := results/bench
# The diagnosis has benchmarks of its own that take hours: see docs/results.md
bench: ## speed on this machine of model, controller and drivers, as JSON (results/bench, minutes)
	mkdir -p $(BENCH); missed=0; for name in model controller reading serial dynamixel; do \
		$(RUN) python benchmarks/bench_$$name.py --json $(BENCH)/$$name.json || missed=1; \
	done; exit $$missed

figures: ## every figure that users rely on, in one file (an hour): ARGS="--parts ticks" or ARGS="--beside OLD NEW"
	$(RUN) python benchmarks/figures.py $(ARGS)

lint: ## ruff and mypy
	$(RUN) ruff check $(ARGS)
	$(RUN) ruff format --check
	$(RUN) mypy

format: ## let ruff format and mend what it can
	$(RUN) ruff check --fix-only --quiet
	$(RUN) ruff format
