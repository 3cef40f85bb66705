# SPDX-License-Identifier: Apache-2.0
# Constraints of dermis_top for static timing and for hardening, in ns.
# Interface: clk_period and sck_period may be set before this file is read; cut_crossings removes the paths between them.
# clk_period is 1e9 / f_clk_hz of models/design.toml: `dermis generate` writes it.
if {![info exists clk_period]} { set clk_period 200.0 }
if {![info exists sck_period]} { set sck_period 50.0 }

create_clock -name clk -period $clk_period [get_ports clk_i]
create_clock -name sck -period $sck_period [get_ports spi_sck_i]

# The clocks are asynchronous and either may be faster. Levels cross through the two flops of
# dermis_tech_sync. Words (register data, frame bytes, frame length) are stable from before the toggle
# that announces them until the toggle that acknowledges them. This holds if no path into a clock domain
# is longer than one of its periods: even a toggle without delay takes two edges of the receiver before
# the word is sampled (docs/spi.md). Place and route gets this bound for words and toggles. Skew is left
# out, and a short path is harmless. The slacks of dermis synth are within each clock.
if {[info exists cut_crossings]} {
  set_clock_groups -asynchronous -group [get_clocks clk] -group [get_clocks sck]
} else {
  set_max_delay -ignore_clock_latency -from [get_clocks sck] -to [get_clocks clk] $clk_period
  set_max_delay -ignore_clock_latency -from [get_clocks clk] -to [get_clocks sck] $sck_period
  set_false_path -hold -from [get_clocks sck] -to [get_clocks clk]
  set_false_path -hold -from [get_clocks clk] -to [get_clocks sck]
}

# Asynchronous by design: comparators enter the first flops of the synchronizers, the enable pin and
# chip select those of dermis_tech_sync; dermis_reset_sync synchronizes the release of reset.
set_false_path -from [get_ports comp_async_i*]
set_false_path -from [get_ports enable_i]
set_false_path -from [get_ports rst_ni]

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
