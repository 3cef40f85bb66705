// SPDX-License-Identifier: Apache-2.0
// Self-test without a sensor: compares counts of inject, dark and full-scale slots with limits;
// sticky fault masks.
// Interface: row and column side of the packer in, one mask bit per column or row out; fault_o is
// their OR. The first row of a self-test frame clears all masks. test_i clears done_o and cut_o;
// end_i of the frame requested last sets done_o, an enable_i that fell before sets cut_o.
// Timing: a bit is set one clock after its column_valid_i, a row bit one clock after row_valid_i.
// Why columns without current are checked in the full slots: only there a short to a neighbour
// shows half its current.
`include "dermis_design.vh"
`default_nettype none

module dermis_self_test #(
  parameter ROWS      = `DERMIS_ROWS,
  parameter COLS      = `DERMIS_COLS,
  parameter CODE_BITS = `DERMIS_CODE_BITS
) (
  input  wire               clk_i,
  input  wire               rst_ni,
  input  wire               enable_i,
  input  wire               test_i,
  input  wire               test_pending_i,
  input  wire               row_valid_i,
  input  wire               first_i,
  input  wire               test_frame_i,
  input  wire               busy_i,
  input  wire               end_i,
  input  wire [ROWS-1:0]    row_fault_i,
  input  wire               column_valid_i,
  input  wire [6:0]         column_i,
  input  wire [CODE_BITS:0] column_count_i,
  input  wire [7:0]         column_slot_i,
  input  wire [CODE_BITS:0] test_count_i,
  input  wire [15:0]        dark_max_i,
  input  wire [15:0]        full_min_i,
  output wire [COLS-1:0]    inject_fault_o,
  output wire [COLS-1:0]    dark_fault_o,
  output wire [COLS-1:0]    full_fault_o,
  output wire [ROWS-1:0]    row_fault_o,
  output wire               fault_o,
  output wire               done_o,
  output wire               cut_o
);

  reg [COLS-1:0] inject_fault_q;
  reg [COLS-1:0] dark_fault_q;
  reg [COLS-1:0] full_fault_q;
  reg [ROWS-1:0] row_fault_q;
  reg            latest_q;
  reg            done_q;
  reg            asked_q;
  reg            stopped_q;
  reg            cut_q;

  wire            begins;
  wire            ends;
  wire [16:0]     count;
  wire            too_high;
  wire            too_low;
  wire            differs;
  wire            inject;
  wire            dark;
  wire            full;
  wire            driven;
  wire [COLS-1:0] column;

  assign begins   = row_valid_i & first_i & test_frame_i;
  assign ends     = end_i & test_frame_i & latest_q;
  assign count    = {{(16-CODE_BITS){1'b0}}, column_count_i};
  assign too_high = (count > {1'b0, dark_max_i});
  assign too_low  = (count < {1'b0, full_min_i});
  assign differs  = (column_count_i != test_count_i);
  assign inject   = (column_slot_i == 8'hF0);
  assign dark     = (column_slot_i == 8'hF1);
  assign full     = (column_slot_i[7:1] == 7'h79);
  assign driven   = (column_slot_i[0] == column_i[0]);
  assign column   = {{(COLS-1){1'b0}}, 1'b1} << column_i;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      inject_fault_q <= {COLS{1'b0}};
      dark_fault_q   <= {COLS{1'b0}};
      full_fault_q   <= {COLS{1'b0}};
    end else if (begins) begin
      inject_fault_q <= {COLS{1'b0}};
      dark_fault_q   <= {COLS{1'b0}};
      full_fault_q   <= {COLS{1'b0}};
    end else if (column_valid_i) begin
      if (inject & differs)                     inject_fault_q <= inject_fault_q | column;
      if ((dark | (full & ~driven)) & too_high) dark_fault_q   <= dark_fault_q | column;
      if (full & driven & too_low)              full_fault_q   <= full_fault_q | column;
    end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni)          row_fault_q <= {ROWS{1'b0}};
    else if (row_valid_i) row_fault_q <= begins ? row_fault_i : row_fault_q | row_fault_i;

  // A request pending at the first row of a self-test frame, or later, is for another frame.
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      latest_q <= 1'b0;
      done_q   <= 1'b0;
    end else begin
      if (begins)      latest_q <= ~(test_i | test_pending_i);
      else if (test_i) latest_q <= 1'b0;

      if (test_i | begins) done_q <= 1'b0;
      else if (ends)       done_q <= 1'b1;
    end

  // Without enable a request is dropped, and so is its frame, unless its last row is being packed.
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      asked_q   <= 1'b0;
      stopped_q <= 1'b0;
      cut_q     <= 1'b0;
    end else if (test_i) begin
      asked_q   <= enable_i;
      stopped_q <= 1'b0;
      cut_q     <= ~enable_i;
    end else if (ends) begin
      asked_q   <= 1'b0;
      stopped_q <= 1'b0;
    end else if (asked_q) begin
      stopped_q <= stopped_q | ~enable_i;
      if (stopped_q & ~busy_i) begin
        asked_q <= 1'b0;
        cut_q   <= 1'b1;
      end
    end

  assign inject_fault_o = inject_fault_q;
  assign dark_fault_o   = dark_fault_q;
  assign full_fault_o   = full_fault_q;
  assign row_fault_o    = row_fault_q;
  assign fault_o        = (|inject_fault_q) | (|dark_fault_q) | (|full_fault_q) | (|row_fault_q);
  assign done_o         = done_q;
  assign cut_o          = cut_q;

endmodule

`default_nettype wire
