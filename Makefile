# Both targets set up .venv themselves on a fresh clone; the second time they only run.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Small matrices only lose by more threads, on a busy machine a factor of ten.
THREADS := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1

# A file's tests stay together, for what they share; in the order of names, since files of few tests can be the longest.
PYTEST := $(THREADS) $(BIN)/python -m pytest -q --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

.PHONY: demo test lint check slow random-mutants browser docs paper-small wasm wasm-check wheels wheels-check clean

# An editable install takes Python from here, and the kernel from when it was built.
$(VENV)/.installed: $(wildcard packages/*/pyproject.toml) constraints.txt packages/foten/CMakeLists.txt $(wildcard $(addprefix packages/foten/native/,src/* training/* include/* wasm/foten.*))
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable './packages/foten[dev]' --editable './packages/foten-study[analysis]' --editable './packages/foten-lab[sweep]'
	touch $@

demo: $(VENV)/.installed
	$(THREADS) $(BIN)/foten demo -o demo

test: $(VENV)/.installed
	$(PYTEST)

# Every night in .github/workflows/nightly.yml; TESTS chooses some. Status 5 of pytest: nothing was selected.
slow: $(VENV)/.installed
	$(PYTEST) -m 'slow and not gpu' $(TESTS) || { test $$? -eq 5 && echo 'no test is marked slow'; }

# Mutants that nobody chose, 25 of each package by SEED, and the share of them that the tests kill: build/mutants. It goes on where it stopped.
random-mutants: $(VENV)/.installed
	$(THREADS) $(BIN)/python tests/random_mutants.py --seed $(or $(SEED),$(shell git rev-parse HEAD)) $(PACKAGES)

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt zensical 'mkdocstrings[python]' # of the extra docs, as above
	touch $@

# The documentation as a site, in build/site: every link is checked, and every table against its CSV.
docs: $(VENV)/.docs
	$(THREADS) $(BIN)/python docs/make/tables.py --check
	$(BIN)/zensical build --strict --clean
	$(BIN)/python packages/foten/native/wasm/pack.py --out build/site/live && cp -R packages/foten/src/foten/textures build/site/live # of the first page
	$(BIN)/python docs/make/screenshots.py

# Every table and figure of the paper, reduced as each says, in a quarter of an hour on two cores: build/paper. It goes on where it stopped.
SMALL := table-1 table-2 figure-5
paper-small: $(VENV)/.installed
	for name in $(SMALL); do \
	  $(THREADS) $(BIN)/foten sweep paper-small-$$name -o build/paper/results/$$name \
	  && $(BIN)/foten tables build/paper/results/$$name -o build/paper/$$name \
	  && $(BIN)/foten figures build/paper/results/$$name -o build/paper/$$name || exit 1; done
	$(THREADS) $(BIN)/python benchmarks/efficiency.py --seconds 12 --steps 300 --csv build/paper/table-3.csv > build/paper/table-3.md

$(VENV)/.browser: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt playwright axe-playwright-python # of the extra browser, as above
	touch $@

# The page in Chromium, which the system has to have; screenshots in build/screenshots. Without it the tests are skipped.
browser: $(VENV)/.browser
	$(PYTEST) -m 'browser and not slow' tests/test_studio_page.py tests/test_capture_page.py tests/test_study_page.py tests/test_adapt_page.py

lint: $(VENV)/.installed
	$(BIN)/clang-format --dry-run -Werror packages/foten/native/*/*.[ch] benchmarks/*.c
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

check: lint
	$(PYTEST)

$(VENV)/.wasm: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt ziglang # of the extra wasm, which would bring a copy of foten
	touch $@

wasm: $(VENV)/.wasm
	$(BIN)/python packages/foten/native/wasm/build.py

wasm-check: $(VENV)/.wasm
	$(BIN)/python packages/foten/native/wasm/build.py --check

# All of what a release holds, in dist. A C compiler is not needed: Zig's is one of the packages.
$(VENV)/.wheels: constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt cmake lief ninja scikit-build-core ziglang # of the extra wheels
	touch $@

wheels: $(VENV)/.wheels
	$(BIN)/python packages/foten/native/wheels.py
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist ./packages/foten-study ./packages/foten-lab
	$(BIN)/python packages/foten/native/wasm/pack.py

# The wheel of this machine by its own compiler: what its libraries export, and that it renders where no compiler is. Those of a release
# in 'make slow', after 'make wheels' once.
wheels-check: $(VENV)/.installed $(VENV)/.wheels
	$(PYTEST) -m 'slow or not slow' -k 'at_hand or exports_its_own or not_what_it_says' tests/test_wheels.py

clean:
	rm -rf $(VENV) demo build dist
