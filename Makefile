# make demo    simulated drives of five families with a live view; needs Python 3.11, no hardware
# make test    everything that CI checks, from nothing (make test ARGS="tests/cli -x" for a part)
# make test-long  what takes a minute or more by its nature, such as a full line under load
# make check   the part of it that runs no code: lint, format, types, imports
# make proof   random lines in virtual time, on where it stopped; 1000 hours take some ten
# make compare  proves that nothing differs from a commit: make compare BASE=fab6b02
# make fuzz    random bytes, guided by coverage, into every parser (ARGS="roster --seconds 600")
# make coverage  every branch of the protocol and the schedule is taken by a test, or it fails
# make mutants  slips planted in protocol and schedule: how many tests find (ARGS="--sample 100")
# make faults  classes of faults put into a running daemon, and what was seen (ARGS="clock disk")
# make soak    a full line on a busy machine, and what grows (ARGS="--hours 1")
# make bench   the figures of docs, ours and the peers' in one run
# make wheel   dist/lecombus-*.whl, built offline from the lock
# make deb     dist/lecombus_*_amd64.deb and _arm64.deb for Debian 12 and 13, from the locks
# make golden  what the program says in tests, written again: tests/*/golden.txt (ARGS="tests/cli")
# make openapi the description of the HTTP interface, from the routes and the answer models
# make schema  config/roster.schema.json, for editors, from the keys of a roster
# make dashboards  deploy/grafana/*.json, from the code in tests/dashboards/
# make lock    requirements/*.txt anew from *.in (make lock ARGS=--upgrade for newer versions)

ARGS ?=

.PHONY: demo test test-long proof compare fuzz coverage mutants faults soak check bench golden openapi schema \
	dashboards wheel deb lock format clean

demo:
	@scripts/venv runtime
	@.venv/bin/lecombus demo $(ARGS)

# Its closing line says how the whole run ended.
test:
	@scripts/debian-packages
	@scripts/venv dev
	@.venv/bin/python scripts/test $(ARGS)

test-long:
	@scripts/debian-packages
	@scripts/venv dev
	@.venv/bin/python -m pytest -m "long and not hardware" $(ARGS)

check:
	@scripts/venv dev
	@scripts/check

proof faults soak: TOOLS := dev
fuzz mutants: TOOLS := reliability
bench: TOOLS := bench
proof: RUN := proof.run --hours 1000 --length 60
fuzz: RUN := fuzz.run
mutants: RUN := mutation.run
faults: RUN := faults.run
soak: RUN := soak.run
bench: RUN := benchmarks.run

proof fuzz mutants faults soak bench:
	@scripts/venv $(TOOLS)
	@PYTHONPATH=src:tests .venv/bin/python -m $(RUN) $(ARGS)

compare:
	@scripts/venv dev
	@PYTHONPATH=tests .venv/bin/python -m compare --base $(BASE) $(ARGS)

# Without tests that Hypothesis draws: a branch that only they take comes and goes by chance.
coverage:
	@scripts/venv reliability
	@.venv/bin/python -m coverage run -m pytest -q -p no:cacheprovider \
		-m "not hypothesis and not hardware and not long" tests/protocol tests/schedule
	@.venv/bin/python -m coverage report

golden:
	@scripts/venv dev
	@.venv/bin/python -m pytest -q --write-golden $(ARGS)
	@git --no-pager diff --stat -- '*golden.txt'

openapi:
	@scripts/venv dev
	@PYTHONPATH=src:tests .venv/bin/python -m openapi.document

schema:
	@scripts/venv dev
	@PYTHONPATH=src .venv/bin/python scripts/schema

dashboards:
	@scripts/venv dev
	@PYTHONPATH=src:tests .venv/bin/python -m dashboards.boards

wheel:
	@scripts/venv runtime
	@.venv/bin/python -m pip --disable-pip-version-check --quiet wheel --no-deps --no-index \
		--no-build-isolation --wheel-dir dist .
	@rm -rf build

deb:
	@scripts/venv dev
	@PYTHONPATH=src .venv/bin/python scripts/deb $(ARGS)

lock:
	@scripts/venv lock
	@scripts/lock .venv/lock-tools/bin/python $(ARGS)

format:
	@scripts/venv dev
	@.venv/bin/ruff check --quiet --fix src tests examples; .venv/bin/ruff format --quiet src tests examples

clean:
	@rm -rf .venv build dist src/*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
