# make demo   set up, run the main job, print what it made and where
# make test   set up, run lint, types and tests
# make test-extras   arrays and gradients of torch, JAX and Warp, sweeps on a Ray cluster of this machine, logs in the
#                    readers of Rerun and rosbags, kernels of a GPU in NVIDIA's assembler, and run where there is a GPU:
#                    in an environment of its own, .venv-extras (some 4 GB)
# make lock   write locked.txt anew: what taut needs, with versions and hashes
# make bars   the long counts;  make bench  figures against Pinocchio and MuJoCo;  make docs  the site
# make bench-peers   docs/benchmarks.md: the same tasks in Drake, MuJoCo, JAX and others, each installed apart (3 GB)
# make firmware   exported C: time here, instructions on a Cortex-M7 in QEMU
# make scorecard   the rows of docs/reliability.md and how many hold
# make soak   a robot's loop for a minute beside a busy program, against C, beside a sweep; three laws on a Franka's test server
# make fuzz   10,000 mutants of every kind of file that is read: N=100 takes fewer

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
EXTRAS := .venv-extras

.PHONY: demo test test-extras lock bars fuzz scorecard soak bench bench-peers firmware docs clean

demo: $(VENV)/demo.stamp
	$(BIN)/taut run panda_payload --out out/demo

test: $(VENV)/test.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -n 2 --dist loadgroup

test-extras: $(EXTRAS)/test.stamp
	$(EXTRAS)/bin/pytest tests/extras "tests/test_docs.py::test_the_python_on_the_page_runs[tensors.md]"

lock: $(BIN)/python
	$(BIN)/python tools/lock.py

bars: $(VENV)/test.stamp
	TAUT_BARS=1 $(BIN)/pytest -n 2 -m "bars or long or part" -s

N ?= 10000
fuzz: $(VENV)/test.stamp
	$(BIN)/python tests/fuzz/fuzz.py $(N)

scorecard: $(VENV)/test.stamp
	$(BIN)/python tools/scorecard.py

bench: $(VENV)/test.stamp
	cd benchmarks && ../$(BIN)/python run.py
	cd benchmarks && ../$(BIN)/python batch.py

bench-peers: $(VENV)/test.stamp
	cd benchmarks/peers && ../../$(BIN)/python bench.py

soak: $(VENV)/test.stamp
	cd benchmarks && ../$(BIN)/python soak.py
	cd benchmarks && ../$(BIN)/python soak.py c
	cd benchmarks && ../$(BIN)/python soak.py sweep
	cd benchmarks && ../$(BIN)/python soak_franka.py

firmware: $(VENV)/test.stamp
	cd benchmarks && ../$(BIN)/python c_export.py

docs: $(VENV)/test.stamp
	$(BIN)/sphinx-build -q -W --keep-going -b html docs site
	@echo "site/index.html"

clean:
	rm -rf $(VENV) $(EXTRAS) .wheels out site .mypy_cache .ruff_cache .pytest_cache

$(BIN)/python:
	$(PYTHON) -c 'import sys; sys.exit("taut needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)

$(VENV)/demo.stamp: $(BIN)/python pyproject.toml constraints.txt
	$(PIP) install --quiet -c constraints.txt -e ".[arms]"
	@touch $@

# Everything the tests need, and a folder of wheels from which one of them installs taut into an empty environment,
# another reads the servo files and the friction of better-actuator-models, which itself needs Python 3.12, and another
# compares the frames of motors with those of damiao-motor, which itself needs a web server.
$(VENV)/test.stamp: $(BIN)/python pyproject.toml constraints.txt
	$(PIP) install --quiet -c constraints.txt -e ".[arms,can,control,franka,gym,oracles,ruckig,sweep,ur,dev,docs]"
	$(PIP) download --quiet --dest .wheels -c constraints.txt $$($(BIN)/python tools/core_requirements.py)
	$(PIP) download --quiet --dest .wheels -c constraints.txt --no-deps --python-version 3.12 better-actuator-models
	$(PIP) download --quiet --dest .wheels -c constraints.txt --no-deps damiao-motor
	@touch $@

$(EXTRAS)/test.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(EXTRAS)
	$(EXTRAS)/bin/python -m pip --disable-pip-version-check install --quiet -c constraints.txt pytest -e ".[arms,cuda,gym,ptxas,ray,sweep,tensors,viewers]"
	@touch $@
