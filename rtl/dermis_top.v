// SPDX-License-Identifier: Apache-2.0
// Digital half of the array reader: row scan, one synchronizer and one counter a column, one row of codes a slot.
// Interface: comp_async_i in, row_select_o, preset_o and charge_o out to the analog side, all three from registers; column c
// is codes_o[c*CODE_BITS +: CODE_BITS] of row codes_row_o. codes_valid_o pulses once a slot and codes_o stays a whole slot.
// Timing: docs/rtl.md. codes_valid_o rises SYNC_CLOCKS + 1 edges after a slot's last sample. enable_i is synchronous to clk_i;
// rst_ni may fall at any time and must rise away from the clock edge.
// Why the gate is delayed by SYNC_CLOCKS: so that exactly the GATE_CLOCKS samples after t0 count, in either synchronizer form.
`include "dermis_design.vh"
`default_nettype none

module dermis_top #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter COLS          = `DERMIS_COLS,
  parameter CODE_BITS     = `DERMIS_CODE_BITS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter SYNC_LATCH    = 0
) (
  input  wire                                          clk_i,
  input  wire                                          rst_ni,
  input  wire                                          enable_i,
  input  wire [COLS-1:0]                               comp_async_i,
  output wire [ROWS-1:0]                               row_select_o,
  output wire                                          preset_o,
  output wire [COLS-1:0]                               charge_o,
  output wire [COLS*CODE_BITS-1:0]                     codes_o,
  output wire [((ROWS > 1) ? $clog2(ROWS) : 1) - 1:0] codes_row_o,
  output wire                                          codes_valid_o,
  output wire                                          frame_done_o
);

  localparam ROW_BITS    = (ROWS > 1) ? $clog2(ROWS) : 1;
  localparam SYNC_CLOCKS = (SYNC_LATCH != 0) ? 1 : 2;

  // A shorter settle lets the charge of a slot's last sample reach into the next gate. Verilog-2005 has no elaboration
  // $error: a module that does not exist is one line naming the rule in Icarus, Verilator and Yosys alike.
  generate
    if (SETTLE_CLOCKS < 2) begin : gen_settle_error
      dermis_error_settle_clocks_must_be_2_or_more u_error ();
    end
    if (GATE_CLOCKS < 1) begin : gen_gate_error
      dermis_error_gate_clocks_must_be_1_or_more u_error ();
    end
    if (ROWS < 1 || COLS < 1 || CODE_BITS < 1) begin : gen_size_error
      dermis_error_rows_cols_and_code_bits_must_be_1_or_more u_error ();
    end
  endgenerate

  wire                      gate;
  wire                      slot_done;
  wire [ROW_BITS-1:0]       done_row;
  wire                      done_last;
  wire [COLS*CODE_BITS-1:0] counts;
  wire                      gate_count;
  wire                      load;

  dermis_row_scanner #(
    .ROWS          (ROWS),
    .GATE_CLOCKS   (GATE_CLOCKS),
    .SETTLE_CLOCKS (SETTLE_CLOCKS),
    .ROW_BITS      (ROW_BITS)
  ) u_scanner (
    .clk_i        (clk_i),
    .rst_ni       (rst_ni),
    .enable_i     (enable_i),
    .row_select_o (row_select_o),
    .preset_o     (preset_o),
    .gate_o       (gate),
    .slot_done_o  (slot_done),
    .done_row_o   (done_row),
    .done_last_o  (done_last)
  );

  generate
    if (SYNC_CLOCKS == 1) begin : gen_delay_1
      reg gate_q;
      reg done_q;
      always @(posedge clk_i or negedge rst_ni)
        if (!rst_ni) {gate_q, done_q} <= 2'b00;
        else         {gate_q, done_q} <= {gate, slot_done};
      assign gate_count = gate_q;
      assign load       = done_q;
    end else begin : gen_delay_2
      reg [1:0] gate_q;
      reg [1:0] done_q;
      always @(posedge clk_i or negedge rst_ni)
        if (!rst_ni) begin
          gate_q <= 2'b00;
          done_q <= 2'b00;
        end else begin
          gate_q <= {gate_q[0], gate};
          done_q <= {done_q[0], slot_done};
        end
      assign gate_count = gate_q[1];
      assign load       = done_q[1];
    end
  endgenerate

  genvar c;
  generate
    for (c = 0; c < COLS; c = c + 1) begin : gen_column
      if (SYNC_LATCH != 0) begin : gen_sync_latch
        dermis_sync_latch u_sync (
          .clk_i        (clk_i),
          .rst_ni       (rst_ni),
          .inhibit_i    (preset_o),
          .comp_async_i (comp_async_i[c]),
          .pulse_o      (charge_o[c])
        );
      end else begin : gen_sync_ff
        dermis_sync_ff u_sync (
          .clk_i        (clk_i),
          .rst_ni       (rst_ni),
          .inhibit_i    (preset_o),
          .comp_async_i (comp_async_i[c]),
          .pulse_o      (charge_o[c])
        );
      end

      dermis_gated_counter #(
        .CODE_BITS (CODE_BITS)
      ) u_counter (
        .clk_i   (clk_i),
        .rst_ni  (rst_ni),
        .gate_i  (gate_count),
        .pulse_i (charge_o[c]),
        .count_o (counts[c*CODE_BITS +: CODE_BITS])
      );
    end
  endgenerate

  dermis_row_buffer #(
    .COLS      (COLS),
    .CODE_BITS (CODE_BITS),
    .ROW_BITS  (ROW_BITS)
  ) u_buffer (
    .clk_i        (clk_i),
    .rst_ni       (rst_ni),
    .load_i       (load),
    .last_i       (done_last),
    .row_i        (done_row),
    .counts_i     (counts),
    .codes_o      (codes_o),
    .row_o        (codes_row_o),
    .valid_o      (codes_valid_o),
    .frame_done_o (frame_done_o)
  );

endmodule

`default_nettype wire
