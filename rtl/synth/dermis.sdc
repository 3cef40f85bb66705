# SPDX-License-Identifier: Apache-2.0
# Constraints of dermis_top for static timing and for hardening, in ns.
# Interface: clk_period, sck_period, driving_cell (of every input) and the derates of a library may be set before this
# file is read; cut_crossings removes the paths between the clocks, to_safe asks for those of the enable pin.
# clk_period is 1e9 / f_clk_hz of models/design.toml: `dermis generate` writes it.
if {![info exists clk_period]} { set clk_period 200.0 }
if {![info exists sck_period]} { set sck_period 50.0 }

create_clock -name clk -period $clk_period [get_ports clk_i]
create_clock -name sck -period $sck_period [get_ports spi_sck_i]
# Chip select clocks one flop at its falling edge, u_spi.begun_q, half a period of SCK before the first edge that uses it.
# 16 periods are the shortest transfer.
create_clock -name cs -period [expr 16 * $sck_period] -waveform [list [expr 0.5 * $sck_period] [expr 8.5 * $sck_period]] \
  [get_ports spi_cs_ni]

# Skew and jitter of trees that do not exist yet, and cells of one die that differ by 5 %.
set_clock_uncertainty -setup 0.5 [get_clocks {clk sck cs}]
set_clock_uncertainty -hold 0.1 [get_clocks {clk sck cs}]
if {![info exists early_derate]} { set early_derate 1.0 }
if {![info exists late_derate]} { set late_derate 1.0 }
set_timing_derate -early [expr 0.95 * $early_derate]
set_timing_derate -late [expr 1.05 * $late_derate]

# Pads and level shifters: slow edges in, 50 fF out; layout repairs what is slower than 1.5 ns.
if {[info exists driving_cell]} { set_driving_cell -lib_cell $driving_cell [all_inputs] }
set_input_transition 0.5 [all_inputs]
set_load 0.05 [all_outputs]
set_max_transition 1.5 [current_design]

# The clocks are asynchronous and either may be faster. Levels cross through the two flops of
# dermis_tech_sync. Words (register data, frame bytes, frame length) are stable from before the toggle
# that announces them until the toggle that acknowledges them. This holds if no path into a clock domain
# is longer than one of its periods: even a toggle without delay takes two edges of the receiver before
# the word is sampled (docs/spi.md). Place and route gets this bound for words and toggles. Skew is left
# out, and a short path is harmless. The slacks of dermis synth are within each clock.
if {[info exists cut_crossings]} {
  set_clock_groups -asynchronous -group [get_clocks clk] -group [get_clocks {sck cs}]
} else {
  set_max_delay -ignore_clock_latency -from [get_clocks {sck cs}] -to [get_clocks clk] $clk_period
  set_max_delay -ignore_clock_latency -from [get_clocks clk] -to [get_clocks sck] $sck_period
  set_false_path -hold -from [get_clocks {sck cs}] -to [get_clocks clk]
  set_false_path -hold -from [get_clocks clk] -to [get_clocks sck]
}

# Asynchronous by design: comparators enter the first flops of the synchronizers, the enable pin and
# chip select those of dermis_tech_sync; dermis_reset_sync synchronizes the release of reset.
set_false_path -from [get_ports comp_async_i*]
set_false_path -from [get_ports rst_ni]

# The enable pin takes the analog side off through the clear of a flop, in half a period of clk.
if {[info exists to_safe]} {
  set_max_delay -ignore_clock_latency 100.0 -from [get_ports enable_i] -to [get_ports {row_select_o* preset_o charge_o* test_current_o*}]
} else {
  set_false_path -from [get_ports enable_i]
}

# Row lines settle within the slot, clocks before they are sampled; outputs are edges for the analog side.
set_input_delay -clock clk [expr 0.4 * $clk_period] [get_ports row_sense_i*]
set_output_delay -clock clk [expr 0.2 * $clk_period] [get_ports {row_select_o* preset_o charge_o* range_o* test_current_o* frame_start_o}]
# The processor synchronizes its interrupt pin.
set_false_path -to [get_ports frame_ready_o]

# SPI mode 0: the controller changes COPI and CS at falling edges and samples CIPO at rising edges. A
# fifth of a period at 20 MHz is reserved for it in each direction.
set_input_delay -clock sck -clock_fall -max [expr 0.2 * $sck_period] [get_ports {spi_copi_i spi_cs_ni}]
set_input_delay -clock sck -clock_fall -min 0.0 [get_ports {spi_copi_i spi_cs_ni}]
set_output_delay -clock sck [expr 0.2 * $sck_period] [get_ports {spi_cipo_o spi_cipo_oe_o}]

# CS is low from half a period before the first edge until after the last: the driver is on before CIPO is sampled.
set_false_path -from [get_ports spi_cs_ni] -to [get_ports spi_cipo_oe_o]
