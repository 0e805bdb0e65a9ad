.DEFAULT_GOAL := help
.PHONY: help setup demo calibrate test test-rest test-all lint benchmark benchmark-quick split-halves faults preflight-agreement lock clean
.DELETE_ON_ERROR:
# To recipes as a variable of the shell: neither make nor the shell reads a command in its text.
override DIR := $(value DIR)
export DIR
CORES ?= 4

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/\1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

setup: .venv/.installed ## make .venv from requirements.txt (every target does so first)

.venv/.installed: requirements.txt workflow/setup.sh
	@workflow/setup.sh
	@touch $@

demo: .venv/.installed ## make recordings with known truth in demo/ and calibrate them
	.venv/bin/python scripts/simulate.py demo --rig demo
	.venv/bin/snakemake -d demo --cores 2

calibrate: .venv/.installed ## calibrate the recordings of a folder: DIR=folder (ARGS=preflight: only check the logs)
	@test -d "$$DIR" || { echo "make calibrate: no folder DIR=$$DIR" >&2; exit 1; }
	@for path in "$$DIR/.snakemake" "$$DIR/.snakemake/log"; do test ! -L "$$path" || \
		{ echo "make calibrate: $$path is a symbolic link; remove it" >&2; exit 1; }; done
	.venv/bin/snakemake -s "$(CURDIR)/Snakefile" -d "$$DIR" \
		--workflow-profile "$(CURDIR)/profiles/default" --cores $(CORES) $(ARGS)

test: .venv/.installed ## run the fast tests, at most 8 minutes on two cores
	.venv/bin/python -m pytest -m "not slow and not real"

test-rest: .venv/.installed ## run the tests that `make test` leaves out: slow ones, and those on recorded data
	.venv/bin/python -m pytest -m "slow or real"

test-all: .venv/.installed ## run all tests
	.venv/bin/python -m pytest

lint: .venv/.installed ## check style, types, package order, spelling, and the workflow
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy
	PYTHONPATH=scripts .venv/bin/lint-imports --no-cache
	.venv/bin/codespell
	.venv/bin/snakefmt --check Snakefile workflow
	.venv/bin/snakemake --lint

benchmark: .venv/.installed ## measure accuracy and cost into docs/benchmark.md
	.venv/bin/python scripts/benchmark.py benchmark

benchmark-quick: .venv/.installed ## the same with the fewest placements, to the terminal
	.venv/bin/python scripts/benchmark.py benchmark --quick

split-halves: .venv/.installed ## measure whether σ is true into docs/benchmark.md (RECORDINGS=folders of runs: these too)
	PYTHONPATH=scripts OMP_NUM_THREADS=1 .venv/bin/python -m benchmarking.split_halves.split_half_page \
		split_halves --recordings $(RECORDINGS)

faults: .venv/.installed ## measure what faults of recordings and the advice on them come to into docs/faults.md
	PYTHONPATH=scripts:tests OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m helpers.fault_catalog.fault_table faults
	PYTHONPATH=scripts .venv/bin/python -m benchmarking.fault_matrix.fault_matrix faults/matrix

preflight-agreement: .venv/.installed ## compare preflight with whole runs on 200 random configs
	PYTHONPATH=scripts:tests OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 .venv/bin/python -m helpers.preflight_configs preflight-agreement

lock: .venv/.installed ## resolve requirements.in into requirements.txt (UPGRADE=--upgrade: newest versions)
	.venv/bin/uv pip compile -q --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-header $(UPGRADE) requirements.in -o requirements.txt
	sed -i '/- pip:$$/q' workflow/envs/calib.yaml
	sed -n '/^# development/q; s/^\([^#]*[^# ]\).*/      - \1/p' requirements.in >>workflow/envs/calib.yaml

clean: ## remove caches and the demo's files
	rm -rf demo benchmark split_halves faults preflight-agreement .pytest_cache .ruff_cache .mypy_cache .hypothesis .setup.log
	find scripts tests -name __pycache__ -prune -exec rm -rf {} +
