// SPDX-License-Identifier: Apache-2.0
// Digital core of the array reader: scan, convert, pack, test itself, and answer over SPI.
// Interface: analog side at clk_i (comparators in; rows, preset, charge, range, test current out,
// all from registers), host over SPI (docs/spi.md, docs/registers.md). enable_i, rst_ni and the SPI
// pins may change at any time.
// Timing: docs/rtl.md. Two clocks: clk_i, and spi_sck_i in dermis_spi; only toggles and stable data
// cross.
// Why only wires and the range choice are here: each module below is tested and proved separately.
`include "dermis_design.vh"
`default_nettype none

module dermis_top #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter COLS          = `DERMIS_COLS,
  parameter CODE_BITS     = `DERMIS_CODE_BITS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter BREAK_CLOCKS  = `DERMIS_BREAK_CLOCKS,
  parameter SYNC_LATCH    = 0
) (
  input  wire              clk_i,
  input  wire              rst_ni,
  input  wire              enable_i,
  input  wire [COLS-1:0]   comp_async_i,
  input  wire [ROWS-1:0]   row_sense_i,
  output wire [ROWS-1:0]   row_select_o,
  output wire              preset_o,
  output wire [COLS-1:0]   charge_o,
  output wire [2*COLS-1:0] range_o,
  output wire [COLS-1:0]   test_current_o,
  output wire              frame_start_o,
  input  wire              spi_sck_i,
  input  wire              spi_cs_ni,
  input  wire              spi_copi_i,
  output wire              spi_cipo_o,
  output wire              spi_cipo_oe_o,
  output wire              frame_ready_o
);

  // Bytes of a frame with all slots: header 8, CRC 2, and a slot number, codes and overflow bits
  // for each slot.
  localparam CODE_BYTES = (CODE_BITS > 8) ? 2 : 1;
  localparam BANK_BYTES = 10 + (ROWS + 4) * (1 + COLS * CODE_BYTES + (COLS + 7) / 8);

  // With a shorter settle the charge of the last sample would enter the next gate. Verilog-2005 has
  // no elaboration $error; an unknown module gives one line with the rule in Icarus, Verilator and
  // Yosys.
  generate
    if (BREAK_CLOCKS < 1) begin : gen_break_error
      dermis_error_break_clocks_must_be_1_or_more u_error ();
    end
    if (SETTLE_CLOCKS < BREAK_CLOCKS + 2 || SETTLE_CLOCKS > 65535) begin : gen_settle_error
      dermis_error_settle_clocks_must_be_break_clocks_and_2_to_65535 u_error ();
    end
    if (GATE_CLOCKS < 1 || GATE_CLOCKS > 65535) begin : gen_gate_error
      dermis_error_gate_clocks_must_be_1_to_65535 u_error ();
    end
    if (ROWS < 1 || COLS < 1 || ROWS > 128 || COLS > 128) begin : gen_size_error
      dermis_error_rows_and_cols_must_be_1_to_128 u_error ();
    end
    if (CODE_BITS < 1 || CODE_BITS > 16) begin : gen_code_error
      dermis_error_code_bits_must_be_1_to_16 u_error ();
    end
  endgenerate

  wire                      rst_n;
  wire                      enable;

  wire                      continuous;
  wire                      shot;
  wire                      test;
  wire                      dark;
  wire                      hold;
  wire [1:0]                pedestal_mode;
  wire                      range_per_column;
  wire [15:0]               settle;
  wire [15:0]               gate;
  wire [1:0]                range;
  wire [2*COLS-1:0]         range_column;
  wire [15:0]               test_rate;
  wire [15:0]               dark_max;
  wire [15:0]               full_min;
  wire [ROWS-1:0]           row_mask;
  wire [COLS*CODE_BITS-1:0] pedestal;

  wire [ROWS-1:0]           row_select;
  wire                      preset;
  wire [COLS-1:0]           charge;
  wire [COLS-1:0]           test_current;

  wire                      working;
  wire                      scanning;
  wire                      test_pending;
  wire                      busy;
  wire                      row_valid;
  wire [7:0]                slot;
  wire                      first;
  wire                      last;
  wire                      test_frame;
  wire                      dark_frame;
  wire [1:0]                frame_mode;
  wire [15:0]               gate_clocks;
  wire                      count_shift;
  wire [CODE_BITS:0]        count;
  wire [CODE_BITS:0]        test_count;
  wire [16:0]               test_count_wide;
  wire [ROWS-1:0]           row_fault_now;

  wire                      column_valid;
  wire [6:0]                column;
  wire [CODE_BITS:0]        column_count;
  wire [7:0]                column_slot;
  wire [ROWS-1:0]           row_fault;
  wire [COLS-1:0]           inject_fault;
  wire [COLS-1:0]           dark_fault;
  wire [COLS-1:0]           full_fault;
  wire                      fault;
  wire                      test_done;
  wire                      test_cut;
  wire                      underflow;

  wire [15:0]               frame_number;
  wire                      frame_begin;
  wire                      frame_we;
  wire [7:0]                frame_byte;
  wire                      frame_end;
  wire [15:0]               lost;

  wire                      hold_toggle;
  wire                      hold_ack;
  wire [15:0]               frame_address;
  wire [7:0]                frame_data;
  wire [15:0]               frame_length;

  wire                      request_toggle;
  wire                      request_write;
  wire [7:0]                request_address;
  wire [15:0]               request_wdata;
  wire                      ack_toggle;
  wire [15:0]               request_rdata;
  wire                      request_refused;
  wire                      error_toggle;
  wire [15:0]               spi_errors;

  wire                      register_valid;
  wire                      register_write;
  wire [7:0]                register_address;
  wire [15:0]               register_wdata;
  wire [15:0]               register_rdata;
  wire                      register_error;

  dermis_reset_sync u_reset_sync (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .rst_no (rst_n)
  );

  dermis_safe_outputs #(
    .ROWS (ROWS),
    .COLS (COLS)
  ) u_safe_outputs (
    .clk_i          (clk_i),
    .rst_ni         (rst_n),
    .enable_i       (enable_i),
    .working_i      (working),
    .row_select_i   (row_select),
    .preset_i       (preset),
    .charge_i       (charge),
    .test_current_i (test_current),
    .enable_o       (enable),
    .row_select_o   (row_select_o),
    .preset_o       (preset_o),
    .charge_o       (charge_o),
    .test_current_o (test_current_o)
  );

  dermis_reader #(
    .ROWS         (ROWS),
    .COLS         (COLS),
    .CODE_BITS    (CODE_BITS),
    .BREAK_CLOCKS (BREAK_CLOCKS),
    .SYNC_LATCH   (SYNC_LATCH)
  ) u_reader (
    .clk_i           (clk_i),
    .rst_ni          (rst_n),
    .enable_i        (enable),
    .continuous_i    (continuous),
    .shot_i          (shot),
    .test_i          (test),
    .dark_i          (dark),
    .hold_i          (hold),
    .pedestal_mode_i (pedestal_mode),
    .settle_i        (settle),
    .gate_i          (gate),
    .row_mask_i      (row_mask),
    .range_i         (range_per_column ? range_column : {COLS{range}}),
    .test_rate_i     (test_rate),
    .comp_async_i    (comp_async_i),
    .row_sense_i     (row_sense_i),
    .row_select_o    (row_select),
    .preset_o        (preset),
    .charge_o        (charge),
    .range_o         (range_o),
    .test_current_o  (test_current),
    .frame_start_o   (frame_start_o),
    .scanning_o      (scanning),
    .working_o       (working),
    .test_pending_o  (test_pending),
    .busy_i          (busy),
    .row_valid_o     (row_valid),
    .slot_o          (slot),
    .first_o         (first),
    .last_o          (last),
    .test_frame_o    (test_frame),
    .dark_frame_o    (dark_frame),
    .pedestal_mode_o (frame_mode),
    .gate_clocks_o   (gate_clocks),
    .count_shift_i   (count_shift),
    .count_o         (count),
    .test_count_o    (test_count),
    .row_fault_o     (row_fault_now)
  );

  dermis_packer #(
    .COLS      (COLS),
    .CODE_BITS (CODE_BITS)
  ) u_packer (
    .clk_i           (clk_i),
    .rst_ni          (rst_n),
    .row_valid_i     (row_valid),
    .slot_i          (slot),
    .first_i         (first),
    .last_i          (last),
    .test_frame_i    (test_frame),
    .dark_frame_i    (dark_frame),
    .pedestal_mode_i (frame_mode),
    .gate_clocks_i   (gate_clocks),
    .count_i         (count),
    .count_shift_o   (count_shift),
    .busy_o          (busy),
    .pedestal_i      (pedestal),
    .fault_i         (fault),
    .frame_number_o  (frame_number),
    .begin_o         (frame_begin),
    .we_o            (frame_we),
    .byte_o          (frame_byte),
    .end_o           (frame_end),
    .underflow_o     (underflow),
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
    .rst_ni         (rst_n),
    .enable_i       (enable),
    .test_i         (test),
    .test_pending_i (test_pending),
    .row_valid_i    (row_valid),
    .first_i        (first),
    .test_frame_i   (test_frame),
    .busy_i         (busy),
    .end_i          (frame_end),
    .row_fault_i    (row_fault_now),
    .column_valid_i (column_valid),
    .column_i       (column),
    .column_count_i (column_count),
    .column_slot_i  (column_slot),
    .test_count_i   (test_count),
    .dark_max_i     (dark_max),
    .full_min_i     (full_min),
    .inject_fault_o (inject_fault),
    .dark_fault_o   (dark_fault),
    .full_fault_o   (full_fault),
    .row_fault_o    (row_fault),
    .fault_o        (fault),
    .done_o         (test_done),
    .cut_o          (test_cut)
  );

  dermis_frame_buffer #(
    .BANK_BYTES (BANK_BYTES)
  ) u_frame_buffer (
    .clk_i         (clk_i),
    .rst_ni        (rst_n),
    .begin_i       (frame_begin),
    .we_i          (frame_we),
    .byte_i        (frame_byte),
    .end_i         (frame_end),
    .frame_ready_o (frame_ready_o),
    .lost_o        (lost),
    .cs_ni         (spi_cs_ni),
    .hold_toggle_i (hold_toggle),
    .hold_ack_o    (hold_ack),
    .rclk_i        (spi_sck_i),
    .raddr_i       (frame_address),
    .rdata_o       (frame_data),
    .length_o      (frame_length)
  );

  dermis_registers #(
    .ROWS          (ROWS),
    .COLS          (COLS),
    .CODE_BITS     (CODE_BITS),
    .GATE_CLOCKS   (GATE_CLOCKS),
    .SETTLE_CLOCKS (SETTLE_CLOCKS),
    .BREAK_CLOCKS  (BREAK_CLOCKS),
    .SYNC_LATCH    (SYNC_LATCH)
  ) u_registers (
    .clk_i              (clk_i),
    .rst_ni             (rst_n),
    .valid_i            (register_valid),
    .write_i            (register_write),
    .address_i          (register_address),
    .wdata_i            (register_wdata),
    .rdata_o            (register_rdata),
    .error_o            (register_error),
    .continuous_o       (continuous),
    .shot_o             (shot),
    .test_o             (test),
    .dark_o             (dark),
    .hold_o             (hold),
    .pedestal_mode_o    (pedestal_mode),
    .range_per_column_o (range_per_column),
    .settle_o           (settle),
    .gate_o             (gate),
    .range_o            (range),
    .test_rate_o        (test_rate),
    .dark_max_o         (dark_max),
    .full_min_o         (full_min),
    .row_mask_o         (row_mask),
    .range_column_o     (range_column),
    .pedestal_o         (pedestal),
    .scanning_i         (scanning),
    .frame_ready_i      (frame_ready_o),
    .test_done_i        (test_done),
    .test_cut_i         (test_cut),
    .underflow_i        (underflow),
    .fault_i            (fault),
    .frame_number_i     (frame_number),
    .lost_i             (lost),
    .spi_errors_i       (spi_errors),
    .test_count_i       (test_count_wide[15:0]),
    .row_fault_i        (row_fault),
    .inject_fault_i     (inject_fault),
    .dark_fault_i       (dark_fault),
    .full_fault_i       (full_fault)
  );

  dermis_register_port u_register_port (
    .clk_i            (clk_i),
    .rst_ni           (rst_n),
    .request_toggle_i (request_toggle),
    .write_i          (request_write),
    .address_i        (request_address),
    .wdata_i          (request_wdata),
    .ack_toggle_o     (ack_toggle),
    .rdata_o          (request_rdata),
    .refused_o        (request_refused),
    .error_toggle_i   (error_toggle),
    .errors_o         (spi_errors),
    .valid_o          (register_valid),
    .write_o          (register_write),
    .address_o        (register_address),
    .wdata_o          (register_wdata),
    .rdata_i          (register_rdata),
    .error_i          (register_error)
  );

  // Reset directly from the pin: without a transfer SCK has no edge for a synchronous release.
  dermis_spi u_spi (
    .rst_ni           (rst_ni),
    .sck_i            (spi_sck_i),
    .cs_ni            (spi_cs_ni),
    .copi_i           (spi_copi_i),
    .cipo_o           (spi_cipo_o),
    .cipo_oe_o        (spi_cipo_oe_o),
    .request_toggle_o (request_toggle),
    .write_o          (request_write),
    .address_o        (request_address),
    .wdata_o          (request_wdata),
    .ack_toggle_i     (ack_toggle),
    .rdata_i          (request_rdata),
    .refused_i        (request_refused),
    .hold_toggle_o    (hold_toggle),
    .hold_ack_i       (hold_ack),
    .frame_address_o  (frame_address),
    .frame_data_i     (frame_data),
    .frame_length_i   (frame_length),
    .error_toggle_o   (error_toggle)
  );

  // A gate of at most 65535 clocks holds at most 32768 pulses.
  assign test_count_wide = {{(16-CODE_BITS){1'b0}}, test_count};

  wire unused_test_count;
  assign unused_test_count = test_count_wide[16];

endmodule

`default_nettype wire
