// SPDX-License-Identifier: Apache-2.0
// Technology cell of sky130: replaces rtl/dermis_tech_latch.v in synthesis.
// Interface: the same; transparent while gate_ni is low, rst_ni low forces q_o to 0.
// Timing: of sky130_fd_sc_hd__dlrtn_1.
// Why an instance: the library has this latch, and any other latch in the netlist is then an inferred one.
`default_nettype none

module dermis_tech_latch (
  input  wire gate_ni,
  input  wire rst_ni,
  input  wire d_i,
  output wire q_o
);

  sky130_fd_sc_hd__dlrtn_1 u_latch (
    .RESET_B (rst_ni),
    .D       (d_i),
    .GATE_N  (gate_ni),
    .Q       (q_o)
  );

endmodule

`default_nettype wire
