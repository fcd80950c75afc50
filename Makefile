# The commands of the project; `make help` lists them.
#   make test ARGS="-k sonar"             passes ARGS on to the program that the target runs
#   make setup PYTHON311=/path/to/python  chooses the Python
#   make setup PIP_ARGS="--index-url URL" adds options to the one pip call

VENV ?= .venv
# Three for two cores: some tests wait more than they compute.
WORKERS ?= 3
PIP_ARGS ?=
ARGS ?=
export VENV PYTHON311
comma := ,

python := $(VENV)/bin/python
stamp := $(VENV)/.simnfnd-installed
core := $(VENV)/.simnfnd-core

.DEFAULT_GOAL := help
.PHONY: help setup demo test check docs release bench constraints clean packages

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' $(firstword $(MAKEFILE_LIST)) | expand -t 14

setup: packages $(stamp) ## install the Debian libraries and the whole Python environment
	@echo "Ready: $(python)"

packages:
	@bash tools/debian_packages.sh tests

$(python):
	@bash tools/debian_packages.sh
	@found="$$(bash tools/find_python.sh)" && "$$found" -m venv $(VENV)

# The constraints keep numpy where bpy can load it, in whatever order the parts are installed.
define install
@bash tools/debian_packages.sh $(3)
@$(python) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' \
	|| { echo "error: $(VENV) is not Python 3.11; remove it and run make again" >&2; exit 2; }
@echo "Installing $(1) into $(VENV)"
$(python) -m pip install --disable-pip-version-check --quiet $(4) $(PIP_ARGS) -c constraints.txt -e '$(2)'
@touch $@
endef

# Python compiles a module when it is first imported; pip would compile all, 150 MB of them.
$(core): pyproject.toml constraints.txt | $(python)
	$(call install,the factory with Blender and Open3D and the denoiser: about 2 GB,.[blender$(comma)open3d$(comma)denoise],,--no-compile)

$(stamp): pyproject.toml constraints.txt | $(python)
	$(call install,all parts and what the tests need: about 5 GB with the CPU build of torch,.[all$(comma)dev$(comma)docs],tests)
	@touch $(core)

demo: $(core) ## make a small dataset from nothing and a preview of it
	$(VENV)/bin/simnfnd demo $(ARGS)

# Without an order of its own xdist starts with the largest files; the slow ones come first here.
pytest := -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder
test: $(stamp) ## run the tests but those marked slow, some minutes on two cores
	$(python) $(pytest) -m "not slow" $(ARGS)

test-slow: $(stamp) ## run the tests marked slow: whole commands, pages, trainings, interruptions
	$(python) $(pytest) -m slow $(ARGS)

check: $(stamp) ## lint, formatting and types
	$(python) -m ruff check
	$(python) -m ruff format --check
	$(python) -m mypy
	$(VENV)/bin/lint-imports
	$(python) -m tools.old_tables

docs: $(stamp) ## build the docs site into build/docs
	NO_MKDOCS_2_WARNING=1 $(python) -m mkdocs build --quiet --strict $(ARGS)
	@echo "Ready: build/docs/index.html"

release: $(stamp) ## check, build and try what a release consists of, and upload nothing
	@PYTHON="$(CURDIR)/$(python)" PIP_ARGS="$(PIP_ARGS)" bash tools/release.sh

bench: $(stamp) ## run every benchmark, or those named in ARGS
	$(python) -m benchmarks $(ARGS)

constraints: ## write the versions now installed into constraints.txt
	@$(python) -m pip list --format=freeze > $(VENV)/versions.txt
	@grep -E '^#|;' constraints.txt > $(VENV)/constraints.txt
	@sed -E 's/\+[^ ]+$$//' $(VENV)/versions.txt | grep -v -E '^(pip|simnfnd)==' >> $(VENV)/constraints.txt
	@mv $(VENV)/constraints.txt constraints.txt && rm $(VENV)/versions.txt

clean: ## remove build products and caches, never outputs/ or the environment
	rm -rf build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +
