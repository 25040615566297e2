# Both targets set up .venv themselves on a fresh clone; the second time they only run.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Small matrices only lose by more threads, on a busy machine a factor of ten.
THREADS := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

.PHONY: demo test check slow clean

$(VENV)/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(VENV)/.installed
	$(THREADS) $(BIN)/foten demo -o demo

test: $(VENV)/.installed
	$(THREADS) $(BIN)/python -m pytest -q

slow: $(VENV)/.installed
	$(THREADS) $(BIN)/python -m pytest -q -m slow

check: $(VENV)/.installed
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(THREADS) $(BIN)/python -m pytest -q

clean:
	rm -rf $(VENV) demo build dist
