// SPDX-License-Identifier: Apache-2.0
// Function of the library's latch, for the proof of equality alone: written after its Liberty.
// Interface: Q follows D while GATE_N is low and holds while it is high; RESET_B low forces Q to 0 whatever the gate.
// Timing: none.
// Why: Yosys 0.23 reads a Liberty latch with clear wrongly, its enable gate drives the data. Simulation of the netlist uses the
// library's own model, so that this one is checked there.
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
