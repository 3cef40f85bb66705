# SPDX-License-Identifier: Apache-2.0
# Constraints of dermis_top for static timing, and the reference for hardening. Times in ns.
# clk_period is 1e9 / f_clk_hz of models/design.toml (dermis synth compares them); both may be set before this file is read.
if {![info exists clk_period]} { set clk_period 200.0 }
if {![info exists sck_period]} { set sck_period 50.0 }

create_clock -name clk -period $clk_period [get_ports clk_i]
create_clock -name sck -period $sck_period [get_ports spi_sck_i]

# The two know nothing of one another and either may be faster. Levels cross through two flops of dermis_tech_sync; words
# (register data, frame bytes, frame length) rest from before the toggle that announces them until the one that answers it.
# That holds while no path into a clock is longer than one of its periods: the toggle, even if it takes no time at all, needs
# two edges of the receiver before the word is looked at (docs/spi.md). So place and route gets that bound, for words and
# toggles alike; skew does not count, and a short path does no harm. The figures of dermis synth are of each clock by itself.
if {[info exists cut_crossings]} {
  set_clock_groups -asynchronous -group [get_clocks clk] -group [get_clocks sck]
} else {
  set_max_delay -ignore_clock_latency -from [get_clocks sck] -to [get_clocks clk] $clk_period
  set_max_delay -ignore_clock_latency -from [get_clocks clk] -to [get_clocks sck] $sck_period
  set_false_path -hold -from [get_clocks sck] -to [get_clocks clk]
  set_false_path -hold -from [get_clocks clk] -to [get_clocks sck]
}

# Asynchronous by design: the comparators meet the synchronizers' first flops, the enable pin and chip select those of
# dermis_tech_sync, and the reset pin is let go through dermis_reset_sync.
set_false_path -from [get_ports comp_async_i*]
set_false_path -from [get_ports enable_i]
set_false_path -from [get_ports rst_ni]

# The row lines answer within the slot, clocks before they are sampled; the outputs are edges for the analog side.
set_input_delay -clock clk [expr 0.4 * $clk_period] [get_ports row_sense_i*]
set_output_delay -clock clk [expr 0.2 * $clk_period] [get_ports {row_select_o* preset_o charge_o* range_o* test_current_o* frame_start_o}]
# An interrupt pin of a processor is synchronized there.
set_false_path -to [get_ports frame_ready_o]

# SPI mode 0: the controller moves COPI and CS at falling edges and takes CIPO at rising ones, each with a fifth of a period
# of its own at 20 MHz.
set_input_delay -clock sck -clock_fall -max [expr 0.2 * $sck_period] [get_ports {spi_copi_i spi_cs_ni}]
set_input_delay -clock sck -clock_fall -min 0.0 [get_ports {spi_copi_i spi_cs_ni}]
set_output_delay -clock sck [expr 0.2 * $sck_period] [get_ports {spi_cipo_o spi_cipo_oe_o}]

# CS is low from half a period before the first edge until after the last one: its driver is on long before CIPO counts.
set_false_path -from [get_ports spi_cs_ni] -to [get_ports spi_cipo_oe_o]
