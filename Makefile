# Two commands from a bare Debian or Ubuntu: `make demo` and `make test`.

PYTHON := .venv/bin/python
READY := .venv/.ready

.PHONY: demo test test-slow test-lowest ratios measure dist fuzz error-coverage lint docs lock clean

demo: $(READY)
	$(PYTHON) -m vntoolkit demo --out out/demo --overwrite --jobs 2

test: $(READY)
	$(PYTHON) -m pytest -m "not slow" -n 2 --dist loadfile

test-slow: $(READY)
	$(PYTHON) -m pytest -m slow -n 2 --dist loadfile --durations=30

# The default tests with the lowest versions that pyproject.toml admits, in an environment of their own.
test-lowest: .venv-lowest/.ready
	.venv-lowest/bin/python -m pytest -m "not slow" -n 2 --dist loadfile

.venv-lowest/.ready: $(READY)
	$${PYTHON3:-python3} -m venv .venv-lowest
	.venv/bin/uv pip compile pyproject.toml --all-extras --resolution lowest-direct --generate-hashes --quiet \
	    --python .venv-lowest/bin/python --output-file .venv-lowest/requirements.txt
	.venv-lowest/bin/python -m pip install --quiet --require-hashes -r .venv-lowest/requirements.txt
	.venv-lowest/bin/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch .venv-lowest/.ready

# Times of the default as ratios to a plain frame.
ratios: $(READY)
	$(PYTHON) -m benchmarks.ratios

# Every number of docs/measured.md, and the page; an hour. VNTOOLKIT_REAL_DATA: photographs, scans, gels.
measure: $(READY)
	$(PYTHON) -m benchmarks.measure

# Ten thousand damaged files of every kind that is read, then every interrupted run; prints its seed.
fuzz: $(READY)
	$(PYTHON) tests/faults/fuzz.py --count 10000
	$(PYTHON) tests/faults/system_cases.py --count 300
	VNTOOLKIT_KILLS=50 $(PYTHON) -m pytest tests/faults -m slow

# Which of the package's errors the tests raise: the share, and every `raise` that none of them reaches.
error-coverage: $(READY)
	$(PYTHON) scripts/error_coverage.py tests -m "not slow"

lint: $(READY)
	.venv/bin/ruff format --check .
	.venv/bin/ruff check .
	.venv/bin/mypy

# The site, into out/site; a broken link or a warning is an error. Its packages have an environment of their own.
docs: .venv-docs/.ready
	NO_MKDOCS_2_WARNING=1 .venv-docs/bin/mkdocs build --strict --quiet

.venv-docs/.ready: docs/requirements.lock
	$${PYTHON3:-python3} -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r docs/requirements.lock
	touch .venv-docs/.ready

# System libraries, environment and packages; again only when the lock or the project file changes.
$(READY): requirements.lock pyproject.toml scripts/set_up.sh
	sh scripts/set_up.sh
	touch $(READY)

# Newest versions that pyproject.toml admits, pinned with hashes for every platform.
lock: $(READY)
	.venv/bin/uv pip compile pyproject.toml --all-extras --universal --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --upgrade --quiet --custom-compile-command "make lock" \
	    --output-file requirements.lock
	.venv/bin/uv pip compile --group docs --universal --python-version 3.11 \
	    --generate-hashes --no-emit-index-url --upgrade --quiet --custom-compile-command "make lock" \
	    --output-file docs/requirements.lock

# Wheel and source archive, in out/dist.
dist: $(READY)
	rm -rf out/dist
	$(PYTHON) -m hatchling build -d out/dist

clean:
	rm -rf .venv .venv-docs .venv-lowest out
