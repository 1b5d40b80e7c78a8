# Two commands: `make demo` sets up and runs one object all the way; `make test` sets up and passes the tests.
.PHONY: setup demo test clean

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

clean:
	rm -rf .venv out .pytest_cache .mypy_cache .ruff_cache
