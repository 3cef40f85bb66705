// SPDX-License-Identifier: Apache-2.0
// Registers of the chip. Generated from rtl/dermis_registers.rdl; change it there and run: dermis generate
// Interface: valid_i for one clock is an access; each field is a port of its name. Map: docs/registers.md.
// Timing: a write is on the ports after the edge that samples valid_i; pulses are high in that clock;
// rdata_o and error_o are combinational.
// Why rdata_o is 0 without valid_i: address_i comes from SCK and is stable only while valid_i is high.
`include "dermis_design.vh"
`default_nettype none

module dermis_registers #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter COLS          = `DERMIS_COLS,
  parameter CODE_BITS     = `DERMIS_CODE_BITS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter BREAK_CLOCKS  = `DERMIS_BREAK_CLOCKS,
  parameter SYNC_LATCH    = 0,
  parameter RANGE_INDEX   = 2
) (
  input  wire                      clk_i,
  input  wire                      rst_ni,
  input  wire                      valid_i,
  input  wire                      write_i,
  input  wire [7:0]                address_i,
  input  wire [15:0]               wdata_i,
  output wire                      continuous_o,
  output wire                      dark_o,
  output wire [1:0]                pedestal_mode_o,
  output wire                      range_per_column_o,
  output wire                      hold_o,
  output wire [15:0]               settle_o,
  output wire [15:0]               gate_o,
  output wire [1:0]                range_o,
  output wire [15:0]               test_rate_o,
  output wire [15:0]               dark_max_o,
  output wire [15:0]               full_min_o,
  output wire [ROWS-1:0]           row_mask_o,
  output wire [2*COLS-1:0]         range_column_o,
  output wire [CODE_BITS*COLS-1:0] pedestal_o,
  output wire                      shot_o,
  output wire                      test_o,
  input  wire                      scanning_i,
  input  wire                      frame_ready_i,
  input  wire                      test_done_i,
  input  wire                      fault_i,
  input  wire                      test_cut_i,
  input  wire                      underflow_i,
  input  wire [15:0]               frame_number_i,
  input  wire [15:0]               lost_i,
  input  wire [15:0]               spi_errors_i,
  input  wire [15:0]               test_count_i,
  input  wire [ROWS-1:0]           row_fault_i,
  input  wire [COLS-1:0]           inject_fault_i,
  input  wire [COLS-1:0]           dark_fault_i,
  input  wire [COLS-1:0]           full_fault_i,
  output wire [15:0]               rdata_o,
  output wire                      error_o
);

  // Numbers with a size, which Verilog-2005 gives to a parameter's bits only.
  localparam integer GEOMETRY_COLS = COLS;
  localparam integer GEOMETRY_ROWS = ROWS;
  localparam integer FORMAT_CODE_BITS = CODE_BITS;
  localparam integer FORMAT_SYNC_LATCH = ((SYNC_LATCH != 0) ? 1 : 0);
  localparam integer FORMAT_BREAK_CLOCKS = ((BREAK_CLOCKS > 127) ? 127 : BREAK_CLOCKS);
  localparam integer SETTLE_VALUE = SETTLE_CLOCKS;
  localparam integer GATE_VALUE = GATE_CLOCKS;
  localparam integer RANGE_VALUE = RANGE_INDEX;
  localparam integer DARK_MAX_VALUE = ((((GATE_CLOCKS / 2 < (2 << CODE_BITS)) ? GATE_CLOCKS / 2 : (2 << CODE_BITS) - 1) + 31) / 32);
  localparam integer FULL_MIN_VALUE = (((GATE_CLOCKS / 2 < (2 << CODE_BITS)) ? GATE_CLOCKS / 2 : (2 << CODE_BITS) - 1) * 18 / 25);
  localparam integer RANGE_COLUMN_VALUE = RANGE_INDEX;
  localparam [1:0] RANGE_COLUMN_VALUE_LANE = RANGE_COLUMN_VALUE[1:0];

  reg                       continuous_q;
  reg                       dark_q;
  reg  [1:0]                pedestal_mode_q;
  reg                       range_per_column_q;
  reg                       hold_q;
  reg  [15:0]               settle_q;
  reg  [15:0]               gate_q;
  reg  [1:0]                range_q;
  reg  [15:0]               test_rate_q;
  reg  [15:0]               dark_max_q;
  reg  [15:0]               full_min_q;
  reg  [ROWS-1:0]           row_mask_q;
  reg  [ROWS-1:0]           row_mask_d;
  reg  [2*COLS-1:0]         range_column_q;
  reg  [2*COLS-1:0]         range_column_d;
  reg  [CODE_BITS*COLS-1:0] pedestal_q;
  reg  [CODE_BITS*COLS-1:0] pedestal_d;
  reg  [15:0]               rdata;
  reg                       known;

  wire write = valid_i & write_i;

  integer n;
  integer m;

  always @* begin
    n = 0;
    row_mask_d = row_mask_q;
    range_column_d = range_column_q;
    pedestal_d = pedestal_q;
    if (write) begin
      for (n = 0; n < ROWS; n = n + 1)
        if (address_i == 8'h20 + {4'd0, n[7:4]}) begin
          row_mask_d[n] = wdata_i[n % 16];
        end
      for (n = 0; n < COLS; n = n + 1)
        if (address_i == 8'h50 + {3'd0, n[7:3]}) begin
          range_column_d[2*n +: 2] = wdata_i[2*(n % 8) +: 2];
        end
      for (n = 0; n < COLS; n = n + 1)
        if (address_i == 8'h80 + n[7:0]) begin
          pedestal_d[CODE_BITS*n +: CODE_BITS] = wdata_i[CODE_BITS-1:0];
        end
    end
  end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      continuous_q <= 1'h1;
      dark_q <= 1'h0;
      pedestal_mode_q <= 2'h0;
      range_per_column_q <= 1'h0;
      hold_q <= 1'h0;
      settle_q <= SETTLE_VALUE[15:0];
      gate_q <= GATE_VALUE[15:0];
      range_q <= RANGE_VALUE[1:0];
      test_rate_q <= 16'h4000;
      dark_max_q <= DARK_MAX_VALUE[15:0];
      full_min_q <= FULL_MIN_VALUE[15:0];
      row_mask_q <= {(ROWS){1'b1}};
      range_column_q <= {COLS{RANGE_COLUMN_VALUE_LANE}};
      pedestal_q <= {(CODE_BITS*COLS){1'b0}};
    end else if (write) begin
      if (address_i == 8'h03) begin
        continuous_q <= wdata_i[0];
        dark_q <= wdata_i[3];
        pedestal_mode_q <= wdata_i[5:4];
        range_per_column_q <= wdata_i[6];
        hold_q <= wdata_i[7];
      end
      if (address_i == 8'h04) begin
        settle_q <= wdata_i;
      end
      if (address_i == 8'h05) begin
        gate_q <= wdata_i;
      end
      if (address_i == 8'h06) begin
        range_q <= wdata_i[1:0];
      end
      if (address_i == 8'h0B) begin
        test_rate_q <= wdata_i;
      end
      if (address_i == 8'h0D) begin
        dark_max_q <= wdata_i;
      end
      if (address_i == 8'h0E) begin
        full_min_q <= wdata_i;
      end
      row_mask_q <= row_mask_d;
      range_column_q <= range_column_d;
      pedestal_q <= pedestal_d;
    end

  always @* begin
    m     = 0;
    rdata = 16'd0;
    known = 1'b0;
    if (valid_i) begin
      case (address_i)
        8'h00: begin
          known = ~write_i;
          rdata = 16'hDE01;
        end
        8'h01: begin
          known = ~write_i;
          rdata[7:0] = GEOMETRY_COLS[7:0];
          rdata[15:8] = GEOMETRY_ROWS[7:0];
        end
        8'h02: begin
          known = ~write_i;
          rdata[4:0] = FORMAT_CODE_BITS[4:0];
          rdata[8] = FORMAT_SYNC_LATCH[0:0];
          rdata[15:9] = FORMAT_BREAK_CLOCKS[6:0];
        end
        8'h03: begin
          known = 1'b1;
          rdata[0] = continuous_q;
          rdata[3] = dark_q;
          rdata[5:4] = pedestal_mode_q;
          rdata[6] = range_per_column_q;
          rdata[7] = hold_q;
        end
        8'h04: begin
          known = 1'b1;
          rdata = settle_q;
        end
        8'h05: begin
          known = 1'b1;
          rdata = gate_q;
        end
        8'h06: begin
          known = 1'b1;
          rdata[1:0] = range_q;
        end
        8'h07: begin
          known = ~write_i;
          rdata[0] = scanning_i;
          rdata[1] = frame_ready_i;
          rdata[2] = test_done_i;
          rdata[3] = fault_i;
          rdata[4] = test_cut_i;
          rdata[5] = underflow_i;
        end
        8'h08: begin
          known = ~write_i;
          rdata = frame_number_i;
        end
        8'h09: begin
          known = ~write_i;
          rdata = lost_i;
        end
        8'h0A: begin
          known = ~write_i;
          rdata = spi_errors_i;
        end
        8'h0B: begin
          known = 1'b1;
          rdata = test_rate_q;
        end
        8'h0C: begin
          known = ~write_i;
          rdata = test_count_i;
        end
        8'h0D: begin
          known = 1'b1;
          rdata = dark_max_q;
        end
        8'h0E: begin
          known = 1'b1;
          rdata = full_min_q;
        end
        default: known = 1'b0;
      endcase
      for (m = 0; m < ROWS; m = m + 1)
        if (address_i == 8'h20 + {4'd0, m[7:4]}) begin
          rdata[m % 16] = row_mask_q[m];
          known = 1'b1;
        end
      for (m = 0; m < ROWS; m = m + 1)
        if (address_i == 8'h28 + {4'd0, m[7:4]}) begin
          rdata[m % 16] = row_fault_i[m];
          known = ~write_i;
        end
      for (m = 0; m < COLS; m = m + 1)
        if (address_i == 8'h30 + {4'd0, m[7:4]}) begin
          rdata[m % 16] = inject_fault_i[m];
          known = ~write_i;
        end
      for (m = 0; m < COLS; m = m + 1)
        if (address_i == 8'h38 + {4'd0, m[7:4]}) begin
          rdata[m % 16] = dark_fault_i[m];
          known = ~write_i;
        end
      for (m = 0; m < COLS; m = m + 1)
        if (address_i == 8'h40 + {4'd0, m[7:4]}) begin
          rdata[m % 16] = full_fault_i[m];
          known = ~write_i;
        end
      for (m = 0; m < COLS; m = m + 1)
        if (address_i == 8'h50 + {3'd0, m[7:3]}) begin
          rdata[2*(m % 8) +: 2] = range_column_q[2*m +: 2];
          known = 1'b1;
        end
      for (m = 0; m < COLS; m = m + 1)
        if (address_i == 8'h80 + m[7:0]) begin
          rdata[CODE_BITS-1:0] = pedestal_q[CODE_BITS*m +: CODE_BITS];
          known = 1'b1;
        end
    end
  end

  assign continuous_o = continuous_q;
  assign dark_o = dark_q;
  assign pedestal_mode_o = pedestal_mode_q;
  assign range_per_column_o = range_per_column_q;
  assign hold_o = hold_q;
  assign settle_o = settle_q;
  assign gate_o = gate_q;
  assign range_o = range_q;
  assign test_rate_o = test_rate_q;
  assign dark_max_o = dark_max_q;
  assign full_min_o = full_min_q;
  assign row_mask_o = row_mask_q;
  assign range_column_o = range_column_q;
  assign pedestal_o = pedestal_q;
  assign shot_o = write & (address_i == 8'h03) & wdata_i[1];
  assign test_o = write & (address_i == 8'h03) & wdata_i[2];
  assign rdata_o = rdata;
  assign error_o = valid_i & ~known;

endmodule

`default_nettype wire
