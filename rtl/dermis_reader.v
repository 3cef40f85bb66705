// SPDX-License-Identifier: Apache-2.0
// Reader: slot sequencer, a synchronizer and a counter per column, row buffer; one row of counts
// per slot.
// Interface: comp_async_i in; row_select_o, preset_o, charge_o, range_o and test_current_o out, all
// from registers. row_valid_o offers a row: slot_o .. gate_clocks_o describe it, count_o is column
// 0, then the next per count_shift_i. All are stable until the last sample of the next slot; a
// short slot waits for busy_i. enable_i is synchronous.
// Timing: docs/rtl.md. row_valid_o rises SYNC_CLOCKS + 1 edges after the last sample of a slot.
// Why the gate is delayed by SYNC_CLOCKS: exactly the samples of the gate count, with either
// synchronizer.
`include "dermis_design.vh"
`default_nettype none

module dermis_reader #(
  parameter ROWS         = `DERMIS_ROWS,
  parameter COLS         = `DERMIS_COLS,
  parameter CODE_BITS    = `DERMIS_CODE_BITS,
  parameter BREAK_CLOCKS = `DERMIS_BREAK_CLOCKS,
  parameter SYNC_LATCH   = 0
) (
  input  wire               clk_i,
  input  wire               rst_ni,
  input  wire               enable_i,
  input  wire               continuous_i,
  input  wire               shot_i,
  input  wire               test_i,
  input  wire               dark_i,
  input  wire               hold_i,
  input  wire [1:0]         pedestal_mode_i,
  input  wire [15:0]        settle_i,
  input  wire [15:0]        gate_i,
  input  wire [ROWS-1:0]    row_mask_i,
  input  wire [2*COLS-1:0]  range_i,
  input  wire [15:0]        test_rate_i,
  input  wire [COLS-1:0]    comp_async_i,
  input  wire [ROWS-1:0]    row_sense_i,
  output wire [ROWS-1:0]    row_select_o,
  output wire               preset_o,
  output wire [COLS-1:0]    charge_o,
  output wire [2*COLS-1:0]  range_o,
  output wire [COLS-1:0]    test_current_o,
  output wire               frame_start_o,
  output wire               scanning_o,
  output wire               working_o,
  output wire               test_pending_o,
  input  wire               busy_i,
  output wire               row_valid_o,
  output wire [7:0]         slot_o,
  output wire               first_o,
  output wire               last_o,
  output wire               test_frame_o,
  output wire               dark_frame_o,
  output wire [1:0]         pedestal_mode_o,
  output wire [15:0]        gate_clocks_o,
  input  wire               count_shift_i,
  output wire [CODE_BITS:0] count_o,
  output wire [CODE_BITS:0] test_count_o,
  output wire [ROWS-1:0]    row_fault_o
);

  // One bit more than a code, so that a pedestal does not reduce the range.
  localparam COUNT_BITS  = CODE_BITS + 1;
  localparam SYNC_CLOCKS = (SYNC_LATCH != 0) ? 1 : 2;

  // Clocks of dermis_packer for a row: header 8, slot 1, codes, overflow bits, CRC 2, and 5 from
  // end to start.
  localparam PACK_CLOCKS = COLS * ((CODE_BITS > 8) ? 2 : 1) + (COLS + 7) / 8 + 16;

  wire                       gate;
  wire                       inject;
  wire                       full_even;
  wire                       full_odd;
  wire                       frame_load;
  wire                       slot_end;
  wire                       slot_done;
  wire [COLS*COUNT_BITS-1:0] counts;
  wire                       test_pulse;
  wire                       gate_count;
  wire                       load;
  wire                       row_ahead;
  wire                       pending;
  wire                       loaded;

  reg [SYNC_CLOCKS-1:0] gate_q;
  reg [1:0]             gate_test_q;
  reg [SYNC_CLOCKS-1:0] done_q;
  reg [2*COLS-1:0]      range_q;
  reg [ROWS-1:0]        row_sense_q;
  reg [ROWS-1:0]        row_fault_q;
  reg [15:0]            phase_q;
  reg                   level_q;

  dermis_row_scanner #(
    .ROWS         (ROWS),
    .BREAK_CLOCKS (BREAK_CLOCKS),
    .PACK_CLOCKS  (PACK_CLOCKS)
  ) u_scanner (
    .clk_i           (clk_i),
    .rst_ni          (rst_ni),
    .enable_i        (enable_i),
    .continuous_i    (continuous_i),
    .shot_i          (shot_i),
    .test_i          (test_i),
    .dark_i          (dark_i),
    .hold_i          (hold_i),
    .pedestal_mode_i (pedestal_mode_i),
    .settle_i        (settle_i),
    .gate_i          (gate_i),
    .row_mask_i      (row_mask_i),
    .busy_i          (pending),
    .row_select_o    (row_select_o),
    .preset_o        (preset_o),
    .gate_o          (gate),
    .inject_o        (inject),
    .full_even_o     (full_even),
    .full_odd_o      (full_odd),
    .frame_load_o    (frame_load),
    .frame_start_o   (frame_start_o),
    .scanning_o      (scanning_o),
    .test_pending_o  (test_pending_o),
    .slot_end_o      (slot_end),
    .slot_done_o     (slot_done),
    .done_slot_o     (slot_o),
    .done_first_o    (first_o),
    .done_last_o     (last_o),
    .done_test_o     (test_frame_o),
    .done_dark_o     (dark_frame_o),
    .done_mode_o     (pedestal_mode_o),
    .done_gate_o     (gate_clocks_o)
  );

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      gate_q      <= {SYNC_CLOCKS{1'b0}};
      gate_test_q <= 2'b00;
      done_q      <= {SYNC_CLOCKS{1'b0}};
    end else begin
      gate_q      <= (gate_q << 1) | {{(SYNC_CLOCKS-1){1'b0}}, gate};
      gate_test_q <= {gate_test_q[0], gate & inject};
      done_q      <= (done_q << 1) | {{(SYNC_CLOCKS-1){1'b0}}, slot_done};
    end

  assign gate_count = gate_q[SYNC_CLOCKS-1];
  assign load       = done_q[SYNC_CLOCKS-1];
  assign row_ahead  = slot_done | (|done_q) | loaded;
  assign pending    = row_ahead | busy_i;
  assign working_o  = scanning_o | row_ahead;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni)         range_q <= {(2*COLS){1'b0}};
    else if (frame_load) range_q <= range_i;

  // The read-back a clock before the last sample: no gate comes before the first flop.
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) row_sense_q <= {ROWS{1'b0}};
    else         row_sense_q <= row_sense_i;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni)       row_fault_q <= {ROWS{1'b0}};
    else if (slot_end) row_fault_q <= row_sense_q ^ row_select_o;

  // Test pulses: the carry of a phase accumulator that starts with the gate.
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni)                {level_q, phase_q} <= 17'd0;
    else if (inject & preset_o) {level_q, phase_q} <= 17'd0;
    else if (inject)            {level_q, phase_q} <= {1'b0, phase_q} + {1'b0, test_rate_i};

  genvar c;
  generate
    for (c = 0; c < COLS; c = c + 1) begin : gen_column
      wire comp;

      assign comp              = inject ? level_q : comp_async_i[c];
      assign test_current_o[c] = (c % 2 != 0) ? full_odd : full_even;

      if (SYNC_LATCH != 0) begin : gen_sync_latch
        dermis_sync_latch u_sync (
          .clk_i        (clk_i),
          .rst_ni       (rst_ni),
          .inhibit_i    (preset_o),
          .comp_async_i (comp),
          .pulse_o      (charge_o[c])
        );
      end else begin : gen_sync_ff
        dermis_sync_ff u_sync (
          .clk_i        (clk_i),
          .rst_ni       (rst_ni),
          .inhibit_i    (preset_o),
          .comp_async_i (comp),
          .pulse_o      (charge_o[c])
        );
      end

      dermis_gated_counter #(
        .CODE_BITS (COUNT_BITS)
      ) u_counter (
        .clk_i   (clk_i),
        .rst_ni  (rst_ni),
        .gate_i  (gate_count),
        .pulse_i (charge_o[c]),
        .count_o (counts[c*COUNT_BITS +: COUNT_BITS])
      );
    end
  endgenerate

  // Reference for the test pulses: two flops and a counter in either form, so that only columns
  // have latches.
  dermis_sync_ff u_test_sync (
    .clk_i        (clk_i),
    .rst_ni       (rst_ni),
    .inhibit_i    (preset_o),
    .comp_async_i (inject & level_q),
    .pulse_o      (test_pulse)
  );

  dermis_gated_counter #(
    .CODE_BITS (COUNT_BITS)
  ) u_test_counter (
    .clk_i   (clk_i),
    .rst_ni  (rst_ni),
    .gate_i  (gate_test_q[1]),
    .pulse_i (test_pulse),
    .count_o (test_count_o)
  );

  dermis_row_buffer #(
    .COLS       (COLS),
    .COUNT_BITS (COUNT_BITS)
  ) u_buffer (
    .clk_i    (clk_i),
    .rst_ni   (rst_ni),
    .load_i   (load),
    .shift_i  (count_shift_i),
    .counts_i (counts),
    .count_o  (count_o),
    .valid_o  (loaded)
  );

  // An enable pin that fell with the last sample or before has fallen here by now, and stays so.
  assign row_valid_o = loaded & enable_i;

  assign range_o     = range_q;
  assign row_fault_o = row_fault_q;

endmodule

`default_nettype wire
