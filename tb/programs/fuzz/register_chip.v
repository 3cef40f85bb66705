// SPDX-License-Identifier: Apache-2.0
// SPI, register port and registers as the chip joins them, with everything behind them at rest:
// what a fuzzer talks to.
// Interface: the SPI pins, a clock, and the registers' outputs that a host has set; the frame is
// bytes of their own address.
// Timing: as dermis_spi and dermis_register_port; STATUS and the counts are constants, so that an
// answer is known.
// Why not dermis_top: a frame that is being read would make answers depend on the time.
`default_nettype none

module register_chip #(
  parameter ROWS = 16,
  parameter COLS = 16,
  parameter CODE_BITS = 8,
  parameter FRAME_BYTES = 5
) (
  input  wire        clk_i,
  input  wire        rst_ni,
  input  wire        sck_i,
  input  wire        cs_ni,
  input  wire        copi_i,
  output wire        cipo_o,
  output wire [15:0] errors_o,
  output wire [15:0] pulses_o
);

  wire        request_toggle;
  wire        ack_toggle;
  wire        write;
  wire [7:0]  address;
  wire [15:0] wdata;
  wire [15:0] rdata;
  wire        refused;
  wire        hold_toggle;
  wire [15:0] frame_address;
  wire        error_toggle;
  wire        valid;
  wire        bus_write;
  wire [7:0]  bus_address;
  wire [15:0] bus_wdata;
  wire [15:0] bus_rdata;
  wire        bus_error;
  wire        shot;
  wire        test;
  reg  [15:0] pulses_q;
  wire        unused_oe;

  dermis_spi u_spi (
    .rst_ni           (rst_ni),
    .sck_i            (sck_i),
    .cs_ni            (cs_ni),
    .copi_i           (copi_i),
    .cipo_o           (cipo_o),
    .cipo_oe_o        (unused_oe),
    .request_toggle_o (request_toggle),
    .write_o          (write),
    .address_o        (address),
    .wdata_o          (wdata),
    .ack_toggle_i     (ack_toggle),
    .rdata_i          (rdata),
    .refused_i        (refused),
    .hold_toggle_o    (hold_toggle),
    .hold_ack_i       (hold_toggle),
    .frame_address_o  (frame_address),
    .frame_data_i     (frame_address[7:0] ^ 8'hC3),
    .frame_length_i   (FRAME_BYTES[15:0]),
    .error_toggle_o   (error_toggle)
  );

  dermis_register_port u_port (
    .clk_i            (clk_i),
    .rst_ni           (rst_ni),
    .request_toggle_i (request_toggle),
    .write_i          (write),
    .address_i        (address),
    .wdata_i          (wdata),
    .ack_toggle_o     (ack_toggle),
    .rdata_o          (rdata),
    .refused_o        (refused),
    .error_toggle_i   (error_toggle),
    .errors_o         (errors_o),
    .valid_o          (valid),
    .write_o          (bus_write),
    .address_o        (bus_address),
    .wdata_o          (bus_wdata),
    .rdata_i          (bus_rdata),
    .error_i          (bus_error)
  );

  dermis_registers #(
    .ROWS      (ROWS),
    .COLS      (COLS),
    .CODE_BITS (CODE_BITS)
  ) u_registers (
    .clk_i              (clk_i),
    .rst_ni             (rst_ni),
    .valid_i            (valid),
    .write_i            (bus_write),
    .address_i          (bus_address),
    .wdata_i            (bus_wdata),
    .continuous_o       (),
    .dark_o             (),
    .pedestal_mode_o    (),
    .range_per_column_o (),
    .settle_o           (),
    .gate_o             (),
    .range_o            (),
    .test_rate_o        (),
    .dark_max_o         (),
    .full_min_o         (),
    .row_mask_o         (),
    .range_column_o     (),
    .pedestal_o         (),
    .shot_o             (shot),
    .test_o             (test),
    .scanning_i         (1'b1),
    .frame_ready_i      (1'b0),
    .test_done_i        (1'b1),
    .fault_i            (1'b0),
    .frame_number_i     (16'h1234),
    .lost_i             (16'h0567),
    .spi_errors_i       (errors_o),
    .test_count_i       (16'h0089),
    .row_fault_i        ({ROWS{1'b1}}),
    .inject_fault_i     ({COLS{1'b0}}),
    .dark_fault_i       ({COLS{1'b1}}),
    .full_fault_i       ({COLS{1'b0}}),
    .rdata_o            (bus_rdata),
    .error_o            (bus_error)
  );

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) pulses_q <= 16'd0;
    else         pulses_q <= pulses_q + {15'd0, shot} + {15'd0, test};

  assign pulses_o = pulses_q;

endmodule

`default_nettype wire
