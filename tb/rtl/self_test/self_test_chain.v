// SPDX-License-Identifier: Apache-2.0
// Bench only: reader, packer and self-test as dermis_top joins them, with their settings as pins
// instead of registers.
`default_nettype none

module self_test_chain #(
  parameter ROWS      = 4,
  parameter COLS      = 5,
  parameter CODE_BITS = 5
) (
  input  wire            clk_i,
  input  wire            rst_ni,
  input  wire            enable_i,
  input  wire            continuous_i,
  input  wire            test_i,
  input  wire            dark_i,
  input  wire [15:0]     gate_i,
  input  wire [15:0]     dark_max_i,
  input  wire [15:0]     full_min_i,
  input  wire [COLS-1:0] comp_async_i,
  input  wire [ROWS-1:0] row_sense_i,
  output wire [ROWS-1:0] row_select_o,
  output wire            preset_o,
  output wire [COLS-1:0] charge_o,
  output wire [COLS-1:0] test_current_o,
  output wire [COLS-1:0] inject_fault_o,
  output wire [COLS-1:0] dark_fault_o,
  output wire [COLS-1:0] full_fault_o,
  output wire [ROWS-1:0] row_fault_o,
  output wire            fault_o,
  output wire            done_o,
  output wire            cut_o,
  output wire            end_o
);

  wire               test_pending;
  wire               busy;
  wire               row_valid;
  wire [7:0]         slot;
  wire               first;
  wire               last;
  wire               test_frame;
  wire               dark_frame;
  wire [15:0]        gate_clocks;
  wire               count_shift;
  wire [CODE_BITS:0] count;
  wire [CODE_BITS:0] test_count;
  wire [ROWS-1:0]    row_fault;
  wire               column_valid;
  wire [6:0]         column;
  wire [CODE_BITS:0] column_count;
  wire [7:0]         column_slot;

  dermis_reader #(
    .ROWS      (ROWS),
    .COLS      (COLS),
    .CODE_BITS (CODE_BITS)
  ) u_reader (
    .clk_i          (clk_i),
    .rst_ni         (rst_ni),
    .enable_i       (enable_i),
    .continuous_i   (continuous_i),
    .shot_i         (1'b0),
    .test_i         (test_i),
    .dark_i         (dark_i),
    .hold_i         (1'b0),
    .pedestal_mode_i (2'd0),
    .settle_i       (16'd6),
    .gate_i         (gate_i),
    .row_mask_i     ({ROWS{1'b1}}),
    .range_i        ({(2*COLS){1'b0}}),
    .test_rate_i    (16'h7000),
    .comp_async_i   (comp_async_i),
    .row_sense_i    (row_sense_i),
    .row_select_o   (row_select_o),
    .preset_o       (preset_o),
    .charge_o       (charge_o),
    .range_o        (),
    .test_current_o (test_current_o),
    .frame_start_o  (),
    .scanning_o     (),
    .working_o      (),
    .test_pending_o (test_pending),
    .busy_i         (busy),
    .row_valid_o    (row_valid),
    .slot_o         (slot),
    .first_o        (first),
    .last_o         (last),
    .test_frame_o   (test_frame),
    .dark_frame_o   (dark_frame),
    .pedestal_mode_o (),
    .gate_clocks_o  (gate_clocks),
    .count_shift_i  (count_shift),
    .count_o        (count),
    .test_count_o   (test_count),
    .row_fault_o    (row_fault)
  );

  dermis_packer #(
    .COLS      (COLS),
    .CODE_BITS (CODE_BITS)
  ) u_packer (
    .clk_i           (clk_i),
    .rst_ni          (rst_ni),
    .row_valid_i     (row_valid),
    .slot_i          (slot),
    .first_i         (first),
    .last_i          (last),
    .test_frame_i    (test_frame),
    .dark_frame_i    (dark_frame),
    .gate_clocks_i   (gate_clocks),
    .count_i         (count),
    .count_shift_o   (count_shift),
    .busy_o          (busy),
    .pedestal_mode_i (2'd0),
    .pedestal_i      ({(COLS*CODE_BITS){1'b0}}),
    .fault_i         (fault_o),
    .frame_number_o  (),
    .begin_o         (),
    .we_o            (),
    .byte_o          (),
    .end_o           (end_o),
    .underflow_o     (),
    .column_valid_o  (column_valid),
    .column_o        (column),
    .column_count_o  (column_count),
    .column_slot_o   (column_slot)
  );

  dermis_self_test #(
    .ROWS      (ROWS),
    .COLS      (COLS),
    .CODE_BITS (CODE_BITS)
  ) u_self_test (
    .clk_i          (clk_i),
    .rst_ni         (rst_ni),
    .enable_i       (enable_i),
    .test_i         (test_i),
    .test_pending_i (test_pending),
    .row_valid_i    (row_valid),
    .first_i        (first),
    .test_frame_i   (test_frame),
    .busy_i         (busy),
    .end_i          (end_o),
    .row_fault_i    (row_fault),
    .column_valid_i (column_valid),
    .column_i       (column),
    .column_count_i (column_count),
    .column_slot_i  (column_slot),
    .test_count_i   (test_count),
    .dark_max_i     (dark_max_i),
    .full_min_i     (full_min_i),
    .inject_fault_o (inject_fault_o),
    .dark_fault_o   (dark_fault_o),
    .full_fault_o   (full_fault_o),
    .row_fault_o    (row_fault_o),
    .fault_o        (fault_o),
    .done_o         (done_o),
    .cut_o          (cut_o)
  );

endmodule

`default_nettype wire
