# TriPillar: every target sets up what it needs. Bare `make` lists them.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
OUT ?= out
WORKERS = --numprocesses $(shell $(PYTHON) -c 'import os; print(min(5, 1 + os.cpu_count()))') --dist worksteal
export PYTHONDONTWRITEBYTECODE :=  # compiled files are kept, so that the many processes which tests start load quickly

.DEFAULT_GOAL := help
.PHONY: help setup train dataset picture paper bench edge-cases robustness firmware simulator hardware-test test test-wide test-long docs check format clean

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' $(MAKEFILE_LIST) | expand -t 22

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, this is " + sys.version)'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $(READY)

setup: $(READY)  ## make .venv with the pinned dependencies

train: $(READY)  ## design -> CAD -> FEM -> dataset -> networks -> table
	$(BIN)/tripillar run --out $(OUT)

dataset: $(READY)  ## the same, up to the datasets
	$(BIN)/tripillar run --out $(OUT) --until dataset

picture: $(READY)  ## draw the pictures of the README and of docs/ again
	$(BIN)/python -m studies draw-arrays docs
	$(BIN)/python -m studies draw-live docs/live.svg
	$(BIN)/python -m studies draw-drawings docs
	$(BIN)/python -m studies draw-rubber docs
	$(BIN)/python -m studies paper --out $(OUT)/paper --docs docs
	$(BIN)/python -m studies draw-page docs/page.png
	$(BIN)/python -m studies draw-gallery docs

paper: $(READY)  ## the paper's figures 6 to 11, tables 1 and 2 and spacing beside ours: out/paper/index.html
	$(BIN)/python -m studies paper --out $(OUT)/paper

bench: $(READY)  ## run time and training time against error, beside other programs where installed
	for study in gate arrays training virtual pressing layouts hardware page; do \
		$(BIN)/python -m studies $$study --out $(OUT)/bench || exit; \
	done

edge-cases: $(READY)  ## scenes at the edge of what can be solved: each right or refused, never wrong
	$(BIN)/python -m pytest -m 'long or not long' -k edge tests/fem/test_edges.py tests/fem/test_golden.py

robustness: $(READY)  ## what worse sensors cost, and what measured pairs buy back
	$(BIN)/python -m studies robustness --out $(OUT)/robustness

firmware:  ## the boards' firmware, ready to flash
	$(MAKE) -C hardware/firmware OUT=$(abspath $(OUT))/firmware all

simulator: firmware  ## the program that runs that firmware on a simulated chip
	$(MAKE) -C hardware/firmware OUT=$(abspath $(OUT))/firmware simulator

hardware-test: $(READY)  ## run those of real ports, simulated chips and a real browser, and say why any is skipped
	$(BIN)/python -m pytest $(WORKERS) -rs -m 'real and not long'

test-wide: $(READY)  ## run more cases of what `make test` holds on one, seconds each, which CI runs too
	$(BIN)/python -m pytest $(WORKERS) -m wide

test: $(READY)  ## run the tests, a process more than there are cores, since some wait: five at most
	$(BIN)/python -m pytest $(WORKERS)

test-long: $(READY)  ## run those that take minutes each: an hour of frames, a million damaged ones, the edge cases
	$(BIN)/python -m pytest $(WORKERS) -m long

docs: $(READY)  ## docs/ as pages with the API, out/docs/site/index.html; with a search: mkdocs serve
	$(BIN)/python docs/site-parts/command_reference.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir $(abspath $(OUT))/docs/site

check: $(READY)  ## what CI runs: style, types, tests
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(MAKE) test test-wide hardware-test

format: $(READY)  ## lay the code out
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

clean:  ## remove what the pipeline wrote, the cache included
	rm -rf $(OUT)
