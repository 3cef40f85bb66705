* SPDX-License-Identifier: Apache-2.0
* ESD cell of an analog pad: a diode to either supply, 0.4 pF in all, with no resistance in the path of the current.
.subckt esd_pad pad vdd vss
xd_up pad vdd sky130_fd_pr__diode_pd2nw_11v0 area=308e12 perim=420e6 rs_int=340
xd_down vss pad sky130_fd_pr__diode_pw2nd_11v0 area=308e12 perim=420e6 rs_int=340
.ends esd_pad
* Clamp between the supplies: it closes while vdd rises faster than 1 us, and lets ramps of 10 us pass.
.subckt esd_clamp vdd vss
xr_wait vdd v_wait vss sky130_fd_pr__res_xhigh_po w=0.69 l=100
xn_wait vss v_wait vss vss nmos w=20 l=20 k=2
xnot v_wait gate vdd vss vss inverter k=20
xn_clamp vdd gate vss vss nmos w=50 l=0.5 k=40
.ends esd_clamp
