// SPDX-License-Identifier: Apache-2.0
// Function of the latch of the library, from its Liberty; used only by the equivalence proof.
// Interface: Q follows D while GATE_N is low and holds while it is high; RESET_B low forces Q to 0 at any gate.
// Timing: none.
// Why: Yosys 0.23 misreads a Liberty latch with clear: its enable gate drives the data. Gate-level simulation uses
// the model of the library, and so checks this one.
`default_nettype none

module sky130_fd_sc_hd__dlrtn_1 (
  input  wire RESET_B,
  input  wire D,
  input  wire GATE_N,
  output reg  Q
);

  always @*
    if (!RESET_B)     Q = 1'b0;
    else if (!GATE_N) Q = D;

endmodule

`default_nettype wire
