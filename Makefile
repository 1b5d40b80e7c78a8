# Two commands: `make demo` sets up and runs one object all the way; `make test` sets up and passes the tests.
.PHONY: setup demo test check docs clean

setup:
	scripts/setup.sh

demo: setup
	.venv/bin/freeart21 demo --out out/demo

test:
	scripts/setup.sh dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check --quiet .
	.venv/bin/mypy
	.venv/bin/pytest

# What a change needs while it is made, in under a minute; `make test` is what it owes in the end.
check:
	.venv/bin/ruff check .
	.venv/bin/ruff format --check --quiet .
	.venv/bin/mypy
	.venv/bin/pytest -m quick

# The API's pages, out of the docstrings. Of a package with __all__ pdoc takes that alone: its modules are
# named beside it, but for view/document.py, by whose name __all__ has a function.
ROOMS = freeart21 generator reconstruct export leaderboard simgap
DOCS = out/docs
PDOC = .venv/bin/python -m pdoc
WITH_ALL = $(dir $(shell grep -rl --include=__init__.py __all__ $(ROOMS)))
docs:
	@PYTHONPATH=. $(PDOC) --output-directory $(DOCS) $(addprefix ./,$(ROOMS) $(filter-out %/document.py,$(wildcard $(addsuffix [a-z]*.py,$(WITH_ALL)))))
	@echo "$(DOCS)/index.html"

clean:
	rm -rf .venv out .pytest_cache .mypy_cache .ruff_cache
