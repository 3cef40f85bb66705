// SPDX-License-Identifier: Apache-2.0
// Reader for a stand-alone simulator (Icarus): bursts of clocks until the reader ends the run.
`include "dermis_design.vh"
`default_nettype none

module skin_alone #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter COLS          = `DERMIS_COLS,
  parameter CODE_BITS     = `DERMIS_CODE_BITS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter BREAK_CLOCKS  = `DERMIS_BREAK_CLOCKS,
  parameter SYNC_LATCH    = 0,
  parameter TOPOLOGY      = 1,
  parameter EFFECTS       = 0,
  parameter TERMS         = 1,
  parameter DARK          = 0
);

  reg go;
  initial go = 1'b0;
  always #1 go = ~go;

  skin #(
    .ROWS          (ROWS),
    .COLS          (COLS),
    .CODE_BITS     (CODE_BITS),
    .GATE_CLOCKS   (GATE_CLOCKS),
    .SETTLE_CLOCKS (SETTLE_CLOCKS),
    .BREAK_CLOCKS  (BREAK_CLOCKS),
    .SYNC_LATCH    (SYNC_LATCH),
    .TOPOLOGY      (TOPOLOGY),
    .EFFECTS       (EFFECTS),
    .TERMS         (TERMS),
    .DARK          (DARK)
  ) u_skin (
    .go_i (go)
  );

endmodule

`default_nettype wire
