# One command each: `make check` is what CI runs.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: run test setup format lint types check bench clean fuzz lab

run: setup
	$(BIN)/hil run

test: setup
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --cov --cov-report=term

setup: $(STAMP)

$(STAMP): pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[fast,i8086,report,sweep,test]'
	touch $(STAMP)

format: setup
	$(BIN)/ruff format --check .

lint: setup
	$(BIN)/ruff check .

types: setup
	$(BIN)/mypy

check: format lint types test

fuzz: setup
	$(BIN)/python -m tests.hil.fuzzer --seconds 600 --seed 1

# 77: there can be no lab on this machine, which it has said in capitals.
lab: setup
	$(BIN)/python -m tests.lab.boot || [ $$? -eq 77 ]

bench: setup
	$(BIN)/python -m hil.bench --plot build/bench/scaling.png

clean:
	rm -rf .venv build *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis .coverage
