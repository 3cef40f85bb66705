// SPDX-License-Identifier: Apache-2.0
// Board top for FPGAs: dermis_top with its clock, a power-on reset, and the pins of a board.
// UNTRIED ON HARDWARE: built, timed and simulated only (docs/fpga.md).
// Interface: comparators in; rows, preset and test current (of even and odd columns) out at the
// levels of dermis_top; charge_o is an open drain, low for a packet; CIPO is released while chip
// select is high.
// Timing: the core has clk_i divided by DIVIDE, 2 to 32; constraints are in <board>.lpf or .pcf.
// Why rows come back inside: bare pins have no read-back, so ROW_FAULT cannot report a broken line.
`default_nettype none

module dermis_board #(
  parameter ROWS   = 16,
  parameter COLS   = 16,
  parameter DIVIDE = 2
) (
  input  wire            clk_i,
  input  wire [COLS-1:0] comp_i,
  output wire [ROWS-1:0] row_o,
  output wire [COLS-1:0] charge_o,
  output wire            preset_o,
  output wire [1:0]      test_o,
  input  wire            sck_i,
  input  wire            cs_ni,
  input  wire            copi_i,
  output wire            cipo_o,
  output wire            ready_o
);

  // A misspelt module stops every tool by name (dermis_top).
  generate
    if (COLS < 3 || DIVIDE < 2 || DIVIDE > 32) begin : gen_board_error
      dermis_error_cols_must_be_3_or_more_and_divide_2_to_32 u_error ();
    end
  endgenerate

  localparam integer LAST = DIVIDE - 1;
  localparam integer HALF = DIVIDE / 2;

  reg [4:0] divide_q;
  reg       clk;
  reg [2:0] run_q;
  reg       rst_n_q;

  // Flops of both families start as initialised.
  initial {divide_q, clk, run_q, rst_n_q} = 10'd0;

  always @(posedge clk_i) begin
    divide_q <= (divide_q == LAST[4:0]) ? 5'd0 : divide_q + 5'd1;
    clk      <= (divide_q < HALF[4:0]);
  end

  always @(posedge clk) begin
    run_q   <= {run_q[1:0], 1'b1};
    rst_n_q <= run_q[2];
  end

  wire [COLS-1:0]   charge;
  wire [COLS-1:0]   test_current;
  wire [2*COLS-1:0] unused_range;
  wire              unused_frame_start;
  wire              unused_test_current;
  wire              cipo;
  wire              cipo_oe;

  // Kept whole, so that the netlist that is tested is the one in the bitstream.
  (* keep_hierarchy *)
  dermis_top #(
    .ROWS (ROWS),
    .COLS (COLS)
  ) u_core (
    .clk_i          (clk),
    .rst_ni         (rst_n_q),
    .enable_i       (1'b1),
    .comp_async_i   (comp_i),
    .row_sense_i    (row_o),
    .row_select_o   (row_o),
    .preset_o       (preset_o),
    .charge_o       (charge),
    .range_o        (unused_range),
    .test_current_o (test_current),
    .frame_start_o  (unused_frame_start),
    .spi_sck_i      (sck_i),
    .spi_cs_ni      (cs_ni),
    .spi_copi_i     (copi_i),
    .spi_cipo_o     (cipo),
    .spi_cipo_oe_o  (cipo_oe),
    .frame_ready_o  (ready_o)
  );

  genvar c;
  generate
    for (c = 0; c < COLS; c = c + 1) begin : gen_charge
      assign charge_o[c] = charge[c] ? 1'b0 : 1'bz;
    end
  endgenerate

  assign test_o              = test_current[1:0];
  assign unused_test_current = ^test_current[COLS-1:2];
  assign cipo_o              = cipo_oe ? cipo : 1'bz;

endmodule

`default_nettype wire
