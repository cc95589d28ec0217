# Every target does its own set-up and is safe to repeat; the second run is quick.
# PYTHON names the interpreter for .venv (3.11 or newer); ARGS goes to pytest.
.POSIX:
.PHONY: help setup render test lint soak clean

PYTHON = $$(for p in python3 python3.13 python3.12 python3.11; do \
	if $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then echo $$p; break; fi; done)
ARGS =
BIN = .venv/bin

help:
	@echo "make render   set up, render cornell-box with surfels to out/cornell-box.png, print its time and error"
	@echo "make test     set up, run the whole suite (ARGS='-k grid' picks)"
	@echo "make lint     ruff and pyright"
	@echo "make soak     1,000 frames of every method; eight visitors of the viewer: memory and frame time stay flat"
	@echo "make clean    remove what the above made"

.venv/.installed: pyproject.toml
	@python="$(PYTHON)"; \
	if ! "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
		echo "luxel: needs Python 3.11 or newer: install one and name it, as in 'make setup PYTHON=python3.12'" >&2; exit 2; fi; \
	if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then \
		rm -rf .venv; \
		if ! "$$python" -m venv .venv >/dev/null; then \
			rm -rf .venv; \
			echo "luxel: '$$python -m venv' failed: run 'apt-get install python3-venv' (or the venv package of that Python)" >&2; \
			exit 2; fi; fi
	@echo "luxel: installing into .venv (a minute or two)"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

setup: .venv/.installed
	@sh scripts/ensure_llvm.sh $(BIN)/python

render: setup
	@mkdir -p out
	$(BIN)/luxel render cornell-box --method gibs --size 512x512 --frames 128 --truth -o out/cornell-box.png

test: setup
	@sh scripts/ensure_browser.sh $(BIN)/python
	$(BIN)/python -m pytest $(ARGS)

lint: .venv/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

soak: setup
	$(BIN)/python -m pytest -m soak -v $(ARGS)

clean:
	rm -rf .venv out report build dist .pytest_cache .ruff_cache
	find src tests examples -name __pycache__ -type d -prune -exec rm -rf {} +
