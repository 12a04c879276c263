# `make run` and `make test` set everything up by themselves; nothing else is needed but Python >= 3.11.
PYTHON ?= python3
# what `make test` installs beside the product; CI adds the C cross compiler that rebuilds the FMUs: test,docs,fmus
EXTRAS ?= test,docs
JOBS   ?= 2
VENV   := .venv
TWIN   := $(VENV)/bin/twin
TASKS  := $(foreach task,pressing tapping rolling pushing,experiments/$(task).toml)
FIG4   := $(foreach run,force_position position imperfect imperfect_position,experiments/fig4_$(run).toml)
# workers take files in the order that tests/conftest.py gives them: long ones first
PYTEST := $(VENV)/bin/python -m pytest -n $(JOBS) --dist loadfile

.DEFAULT_GOAL := help
.PHONY: help run tasks test test-all lint bench validation survey docs picture endurance bytes house wheel mutants fmus shell clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 12

run: $(VENV)/.run  ## set up, run the paper's Fig. 4 experiment, score it against the paper, write the page to open
	$(TWIN) run $(FIG4)
	$(TWIN) compare --paper fig4
	$(TWIN) report results/fig4_force_position

# tests start hundreds of processes: none of them should compile what another one has compiled. Lint has time while
# tests wait, and ends before they do
test test-all: export PYTHONDONTWRITEBYTECODE :=
test: TIERS := not slow and not endurance
test: $(VENV)/.test-$(EXTRAS)  ## set up, run the first tier of the tests and, beside it, lint, types, import contracts
test-all: TIERS := not endurance
test-all: $(VENV)/.test-$(EXTRAS)  ## what CI runs: the same with the slow tests
test test-all:
	@trap 'kill $$lint 2>/dev/null' INT TERM; \
	nice -n 10 $(MAKE) --no-print-directory lint >$(VENV)/lint.txt 2>&1 & lint=$$!; \
	$(PYTEST) --no-loadscope-reorder -m "$(TIERS)"; tests=$$?; \
	wait $$lint; linted=$$?; cat $(VENV)/lint.txt; [ $$tests = 0 ] && [ $$linted = 0 ]

lint: $(VENV)/.test-$(EXTRAS)  ## what `make test` runs beside the tests
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports

endurance: $(VENV)/.test-$(EXTRAS)  ## the long tests, and new examples of every property; SEED=n draws those of n again
	@seed=$(or $(SEED),$$(date +%s)); echo "draws the same examples again: make endurance SEED=$$seed"; \
	$(PYTEST) --timeout 0 -m "endurance or hypothesis" \
	  --hypothesis-profile endurance --hypothesis-seed $$seed || { echo "failed with SEED=$$seed"; exit 1; }

# QUICK=1: a part of them; BASE=commit: another commit; ONLY='run pressing*': those cases; KEEP=folder: what they leave
bytes: $(VENV)/.test-$(EXTRAS)  ## does the working tree record and say what a commit before it did, byte for byte?
	@$(VENV)/bin/python -m tests.bytes --jobs $(JOBS) $(if $(BASE),--base $(BASE)) $(if $(QUICK),--quick) \
	  $(if $(ONLY),--only '$(ONLY)') $(if $(KEEP),--keep '$(KEEP)')

house: $(VENV)/.test-$(EXTRAS)  ## how often twin has each idea, and how its files read, beside what is asked
	@$(VENV)/bin/python -m tests.house

wheel: $(VENV)/.test-$(EXTRAS)  ## dist/: a wheel for x86-64 Linux with machine code in it, so that no user waits for it
	$(VENV)/bin/python build_wheel.py dist

mutants: $(VENV)/.test-test,mutants  ## change the source in 400 places, one at a time: do the tests notice? (hours)
	$(VENV)/bin/python -m tests.mutants --jobs $(JOBS) $(MUTANTS)

# RELEASE=0.2.0 adds a line to the history
bench: $(VENV)/.test-test,bench  ## speed, as ratios measured side by side; ONLY='masters chain': those parts
	@command -v chromium >/dev/null || { [ "$$(id -u)" = 0 ] && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y chromium; } >/dev/null 2>&1 || true
	$(VENV)/bin/python -m benchmarks $(RELEASE) $(if $(ONLY),--only $(ONLY))

validation: $(VENV)/.test-validation  ## the twin beside what others made: writes the table of docs/validation.md
	$(VENV)/bin/python -m validation

survey: $(VENV)/.test-$(EXTRAS)  ## try every FMU below FMUS=folder, or system below SYSTEMS=folder: writes docs/compatibility.json
	$(VENV)/bin/python -m validation.survey $(or $(FMUS),docs/compatibility.json) $(if $(SYSTEMS),--systems $(SYSTEMS)) \
	  --sources docs/compatibility.toml

tasks: $(VENV)/.run  ## the four massage tasks of Fig. 5, scored
	$(TWIN) run $(TASKS)
	$(TWIN) compare --paper fig5

# the theme advertises its successor in the build
docs: export NO_MKDOCS_2_WARNING := 1
# of what tests need nothing; where it is all there, it is not installed again
docs: $(or $(wildcard $(VENV)/.test-$(EXTRAS)),$(VENV)/.test-docs)  ## the site: site/index.html
	$(VENV)/bin/python -m mkdocs build --strict

picture: $(VENV)/.test-$(EXTRAS) run tasks  ## redraw the README's pictures
	cp results/fig4/fig4.png docs/fig4.png
	cp results/fig5/fig5.png docs/fig5.png
	$(TWIN) analyse fig4_force_position --no-try
	cp results/analysis/fig4_force_position/disks.png docs/disks.png
	$(VENV)/bin/python -m validation.people docs/bodies.png
	$(TWIN) report results/fig4_force_position
	$(VENV)/bin/python docs/builder/report_picture.py results/fig4_force_position/latest/report.html docs/report.png
	$(VENV)/bin/python docs/builder/explorer_walk.py docs

fmus: $(VENV)/.test-test,fmus  ## rebuild the drive FMUs from their sources; DRIVES=mine builds that one
	$(VENV)/bin/python fmus/build.py $(DRIVES)

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "$(PYTHON) is older than Python 3.11; try: make PYTHON=python3.12"; exit 2; }
	@# with today's pip, which takes half as long as those that come with Python
	$(PYTHON) -m venv --upgrade-deps $(VENV)

$(VENV)/.run: $(VENV)/bin/python pyproject.toml constraints.txt
	@$(VENV)/bin/python set_up.py explore
	@touch $@

$(VENV)/.test-%: $(VENV)/bin/python pyproject.toml constraints.txt
	@$(VENV)/bin/python set_up.py "$*"
	@touch $@ $(VENV)/.run

shell: $(VENV)/.run  ## set up, then a shell in which `twin` is found; exit leaves it
	@. $(VENV)/bin/activate && exec "$${SHELL:-sh}"

clean:  ## remove the environment and all results
	rm -rf $(VENV) site results/*/
