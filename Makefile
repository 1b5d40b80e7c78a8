# Two commands: `make demo` sets up and runs one object all the way; `make test` sets up and passes the tests.
.PHONY: setup demo demo-data test test-torch check results docs clean

setup:
	scripts/setup.sh

demo: setup
	.venv/bin/freeart21 demo --out out/demo

# Three small objects to try scoring on (60 frames each, two hinges and a slider) and a skeleton of results to fill in.
# What they are and how they move is frozen: tests/test_demo_data.py.
demo-data: setup
	.venv/bin/freeart21 record office_scissors folding_usb cover_phone --seed 7 --frames 60 --queries 6 \
		--width 320 --height 180 --shader trivial --workers 2 --out data/demo
	test -d results/demo || .venv/bin/freeart21 init-submission data/demo --out results/demo
	.venv/bin/freeart21 score results/demo --data data/demo || true  # all is priced: nothing is solved yet

# Two processes, a file of tests in one of them, the slow ones first (tests/conftest.py). More would need 2 GB each.
test:
	scripts/setup.sh dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check --quiet .
	.venv/bin/mypy
	.venv/bin/pytest -n 2 --dist loadfile --no-loadscope-reorder

# The tests of PyTorch, ManiSkill, Ray and Open3D, in an environment of their own: 4 GB.
test-torch:
	scripts/setup.sh torch
	.venv-torch/bin/pytest -n 2 --dist loadfile --no-loadscope-reorder -m torch

# What a change needs while it is made: half a minute, 80 s without caches; `make test` is what it owes in the end.
check:
	.venv/bin/ruff check .
	.venv/bin/ruff format --check --quiet .
	.venv/bin/mypy & .venv/bin/pytest -m quick; tests=$$?; wait $$! && exit $$tests

# Every table of the solver by this version, and the tables of README and docs/results.md from them. It can be stopped and goes on.
results:
	scripts/setup.sh dev
	.venv/bin/python -m benchmarks.results

# The API's pages, out of the docstrings, grouped by docs/pdoc/. Of a package with __all__ pdoc takes that alone: its modules
# are named next to it, but for view/document.py, by whose name __all__ has a function.
PACKAGES = freeart21 generator reconstruct export leaderboard simgap
DOCS = out/docs
PDOC = .venv/bin/python -m pdoc
WITH_ALL = $(dir $(shell grep -rl --include=__init__.py __all__ $(PACKAGES)))
docs:
	@PYTHONPATH=. $(PDOC) --template-directory docs/pdoc --output-directory $(DOCS) $(addprefix ./,$(PACKAGES) $(filter-out %/document.py,$(wildcard $(addsuffix [a-z]*.py,$(WITH_ALL))) $(patsubst %/__init__.py,%,$(wildcard $(addsuffix */__init__.py,$(WITH_ALL))))))
	@echo "$(DOCS)/index.html"

clean:
	rm -rf .venv .venv-torch node_modules out .pytest_cache .mypy_cache .ruff_cache
