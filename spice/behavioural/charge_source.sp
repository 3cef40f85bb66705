* SPDX-License-Identifier: Apache-2.0
* Charge source: out sinks i0_a (1 + packet_error) while d_charge is high; a negative i0_a sources it.
* d_charge is a factor, so its edges are the edges of the current and equal ramps up and down leave the packet i0_a / f_clk exact.
* Default packet_error is the physical value of design.inc. Ideal: packet_error = 0.
.subckt charge_source d_charge out ibias vdd vss vdd_d vss_d
+ params: i0_a={converter_i0_a} packet_error={charge_packet_error}
.if (i0_a >= 0)
gpacket out vss d_charge vss_d {i0_a*(1 + packet_error)/supply_v_logic_v}
.else
gpacket out vdd d_charge vss_d {i0_a*(1 + packet_error)/supply_v_logic_v}
.endif
.ends charge_source
* The name that the opposite sign has in transistors; here it is in i0_a.
.subckt charge_source_inverted d_charge out ibias vdd vss vdd_d vss_d
+ params: i0_a={converter_i0_a} packet_error={charge_packet_error}
xsource d_charge out ibias vdd vss vdd_d vss_d charge_source i0_a={i0_a} packet_error={packet_error}
.ends charge_source_inverted
