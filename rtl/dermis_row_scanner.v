// SPDX-License-Identifier: Apache-2.0
// Slot sequencer: takes the slots of a frame in order; for each it drives a row, waits in preset,
// then opens the gate.
// Interface: a frame is a list of slots, lowest bit first: inject, dark, full_even, full_odd, row
// 0..ROWS-1. It starts while enable_i and (continuous_i or a pending shot_i or test_i) and not
// hold_i, and samples its settings then (docs/rtl.md).
// Timing: e0 ends the previous row and presets, the row is on from e0 + BREAK_CLOCKS, preset falls
// at t0 = e0 + settle, gate_o is high before the gate_i edges after t0, the last of them e0 of the
// next slot; slot_done_o follows it. With a gate shorter than PACK_CLOCKS, preset also waits until
// busy_i falls, so that no row is overwritten unread.
// Why a slot with all samples is delivered even if enable_i fell with the last: only the pin tells
// whether it was cut before, and dermis_reader knows that when the row is loaded.
`include "dermis_design.vh"
`default_nettype none

module dermis_row_scanner #(
  parameter ROWS         = `DERMIS_ROWS,
  parameter BREAK_CLOCKS = `DERMIS_BREAK_CLOCKS,
  parameter PACK_CLOCKS  = 34
) (
  input  wire            clk_i,
  input  wire            rst_ni,
  input  wire            enable_i,
  input  wire            continuous_i,
  input  wire            shot_i,
  input  wire            test_i,
  input  wire            dark_i,
  input  wire            hold_i,
  input  wire [1:0]      pedestal_mode_i,
  input  wire [15:0]     settle_i,
  input  wire [15:0]     gate_i,
  input  wire [ROWS-1:0] row_mask_i,
  input  wire            busy_i,
  output wire [ROWS-1:0] row_select_o,
  output wire            preset_o,
  output wire            gate_o,
  output wire            inject_o,
  output wire            full_even_o,
  output wire            full_odd_o,
  output wire            frame_load_o,
  output wire            frame_start_o,
  output wire            scanning_o,
  output wire            test_pending_o,
  output wire            slot_end_o,
  output wire            slot_done_o,
  output wire [7:0]      done_slot_o,
  output wire            done_first_o,
  output wire            done_last_o,
  output wire            done_test_o,
  output wire            done_dark_o,
  output wire [1:0]      done_mode_o,
  output wire [15:0]     done_gate_o
);

  localparam SLOTS = ROWS + 4;

  // Two clocks of settle with the row on: the packet of the last sample must end before preset
  // does.
  localparam integer SHORTEST   = BREAK_CLOCKS + 2;
  localparam integer BREAK_LOAD = BREAK_CLOCKS - 1;

  reg             active_q;
  reg             break_q;
  reg             preset_q;
  reg [15:0]      clocks_q;
  reg [SLOTS-1:0] slots_q;
  reg [ROWS-1:0]  row_select_q;
  reg             inject_q;
  reg             full_even_q;
  reg             full_odd_q;
  reg             shot_q;
  reg             test_q;
  reg             first_q;
  reg             test_frame_q;
  reg             dark_frame_q;
  reg [1:0]       mode_q;
  reg             short_q;
  reg [15:0]      settle_q;
  reg [15:0]      gate_q;
  reg             frame_start_q;
  reg             slot_done_q;
  reg [7:0]       done_slot_q;
  reg             done_first_q;
  reg             done_last_q;
  reg             done_test_q;
  reg             done_dark_q;
  reg [1:0]       done_mode_q;
  reg [15:0]      done_gate_q;

  wire             expired;
  wire             slot_end;
  wire             last;
  wire             wanted;
  wire             frame_load;
  wire             slot_start;
  wire [SLOTS-1:0] list;
  wire [SLOTS-1:0] rest;
  wire [SLOTS-1:0] next;

  // Lowest slot of a list. A function, so that a simulator evaluates it once a slot, not every
  // clock.
  function [7:0] number;
    input [SLOTS-1:0] slots;
    integer r;
    begin
      number = 8'hF3;
      for (r = ROWS - 1; r >= 0; r = r - 1)
        if (slots[r + 4]) number = r[7:0];
      if (slots[3]) number = 8'hF3;
      if (slots[2]) number = 8'hF2;
      if (slots[1]) number = 8'hF1;
      if (slots[0]) number = 8'hF0;
    end
  endfunction

  assign expired    = (clocks_q == 16'd0);
  assign slot_end   = active_q & ~preset_q & expired;
  assign rest       = slots_q & (slots_q - 1'b1);
  assign last       = (rest == {SLOTS{1'b0}});
  assign wanted     = (continuous_i | shot_q | test_q) & ~hold_i;
  assign list       = {row_mask_i, test_q, test_q, dark_i | test_q, test_q};
  assign frame_load = enable_i & wanted & (list != {SLOTS{1'b0}}) & (~active_q | (slot_end & last));
  assign slot_start = frame_load | (enable_i & slot_end & ~last);
  assign next       = frame_load ? list : rest;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      active_q     <= 1'b0;
      break_q      <= 1'b0;
      preset_q     <= 1'b1;
      clocks_q     <= 16'd0;
      slots_q      <= {SLOTS{1'b0}};
      row_select_q <= {ROWS{1'b0}};
      inject_q     <= 1'b0;
      full_even_q  <= 1'b0;
      full_odd_q   <= 1'b0;
    end else if (slot_start) begin
      active_q     <= 1'b1;
      break_q      <= 1'b1;
      preset_q     <= 1'b1;
      clocks_q     <= BREAK_LOAD[15:0];
      slots_q      <= next;
      row_select_q <= {ROWS{1'b0}};
      inject_q     <= next[0];
      full_even_q  <= next[2] & ~next[0] & ~next[1];
      full_odd_q   <= next[3] & ~next[0] & ~next[1] & ~next[2];
    end else if (slot_end | ~enable_i) begin
      active_q     <= 1'b0;
      break_q      <= 1'b0;
      preset_q     <= 1'b1;
      row_select_q <= {ROWS{1'b0}};
      inject_q     <= 1'b0;
      full_even_q  <= 1'b0;
      full_odd_q   <= 1'b0;
    end else if (active_q) begin
      if (!expired) begin
        clocks_q     <= clocks_q - 1'b1;
      end else if (break_q) begin
        break_q      <= 1'b0;
        row_select_q <= (slots_q[3:0] == 4'd0) ? slots_q[SLOTS-1:4] & ~rest[SLOTS-1:4] : {ROWS{1'b0}};
        clocks_q     <= settle_q;
      end else if (!(busy_i & short_q)) begin
        preset_q     <= 1'b0;
        clocks_q     <= gate_q - 1'b1;
      end
    end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      shot_q        <= 1'b0;
      test_q        <= 1'b0;
      first_q       <= 1'b0;
      test_frame_q  <= 1'b0;
      dark_frame_q  <= 1'b0;
      mode_q        <= 2'd0;
      short_q       <= 1'b0;
      settle_q      <= 16'd0;
      gate_q        <= 16'd0;
      frame_start_q <= 1'b0;
    end else begin
      shot_q        <= enable_i & (shot_i | (shot_q & ~(frame_load & ~test_q)));
      test_q        <= enable_i & (test_i | (test_q & ~frame_load));
      frame_start_q <= frame_load;
      if (frame_load) begin
        first_q      <= 1'b1;
        test_frame_q <= test_q;
        dark_frame_q <= list[1];
        mode_q       <= pedestal_mode_i;
        short_q      <= (gate_i < PACK_CLOCKS[15:0]);
        settle_q     <= ((settle_i < SHORTEST[15:0]) ? SHORTEST[15:0] : settle_i) - BREAK_CLOCKS[15:0] - 16'd1;
        gate_q       <= (gate_i == 16'd0) ? 16'd1 : gate_i;
      end else if (slot_end) begin
        first_q      <= 1'b0;
      end
    end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      slot_done_q  <= 1'b0;
      done_slot_q  <= 8'd0;
      done_first_q <= 1'b0;
      done_last_q  <= 1'b0;
      done_test_q  <= 1'b0;
      done_dark_q  <= 1'b0;
      done_mode_q  <= 2'd0;
      done_gate_q  <= 16'd0;
    end else begin
      slot_done_q <= slot_end;
      if (slot_end) begin
        done_slot_q  <= number(slots_q);
        done_first_q <= first_q;
        done_last_q  <= last;
        done_test_q  <= test_frame_q;
        done_dark_q  <= dark_frame_q;
        done_mode_q  <= mode_q;
        done_gate_q  <= gate_q;
      end
    end

  assign row_select_o   = row_select_q;
  assign preset_o       = preset_q;
  assign gate_o         = ~preset_q;
  assign inject_o       = inject_q;
  assign full_even_o    = full_even_q;
  assign full_odd_o     = full_odd_q;
  assign frame_load_o   = frame_load;
  assign frame_start_o  = frame_start_q;
  assign scanning_o     = active_q;
  assign test_pending_o = test_q;
  assign slot_end_o     = slot_end;
  assign slot_done_o    = slot_done_q;
  assign done_slot_o    = done_slot_q;
  assign done_first_o   = done_first_q;
  assign done_last_o    = done_last_q;
  assign done_test_o    = done_test_q;
  assign done_dark_o    = done_dark_q;
  assign done_mode_o    = done_mode_q;
  assign done_gate_o    = done_gate_q;

endmodule

`default_nettype wire
