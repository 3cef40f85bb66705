// SPDX-License-Identifier: Apache-2.0
// WRONG on purpose: dermis_row_scanner that presets once, in the first settle after enable, and not between rows.
// The charge a taxel below 500 ohm leaves behind is counted in the next row (FACTS 1.4).
`include "dermis_design.vh"
`default_nettype none

module dermis_row_scanner #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter ROW_BITS      = (ROWS > 1) ? $clog2(ROWS) : 1
) (
  input  wire                clk_i,
  input  wire                rst_ni,
  input  wire                enable_i,
  output wire [ROWS-1:0]     row_select_o,
  output wire                preset_o,
  output wire                gate_o,
  output wire                slot_done_o,
  output wire [ROW_BITS-1:0] done_row_o,
  output wire                done_last_o
);

  localparam LONGEST  = (GATE_CLOCKS > SETTLE_CLOCKS) ? GATE_CLOCKS : SETTLE_CLOCKS;
  localparam CLK_BITS = (LONGEST > 1) ? $clog2(LONGEST) : 1;

  localparam integer SETTLE_LOAD = SETTLE_CLOCKS - 1;
  localparam integer GATE_LOAD   = GATE_CLOCKS - 1;
  localparam integer LAST_ROW    = ROWS - 1;

  reg                active_q;
  reg [ROWS-1:0]     row_select_q;
  reg                preset_q;
  reg                settle_q;
  reg [CLK_BITS-1:0] clocks_q;
  reg [ROW_BITS-1:0] row_q;
  reg                slot_done_q;
  reg [ROW_BITS-1:0] done_row_q;
  reg                done_last_q;

  wire                expired;
  wire                slot_end;
  wire                slot_start;
  wire                last_row;
  wire [ROW_BITS-1:0] next_row;

  assign expired    = (clocks_q == {CLK_BITS{1'b0}});
  assign last_row   = (row_q == LAST_ROW[ROW_BITS-1:0]);
  assign slot_end   = active_q & ~settle_q & expired;
  assign slot_start = enable_i & (slot_end | ~active_q);
  assign next_row   = (~active_q | last_row) ? {ROW_BITS{1'b0}} : row_q + 1'b1;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      active_q     <= 1'b0;
      row_select_q <= {ROWS{1'b0}};
      preset_q     <= 1'b1;
      settle_q     <= 1'b1;
      clocks_q     <= {CLK_BITS{1'b0}};
      row_q        <= {ROW_BITS{1'b0}};
      slot_done_q  <= 1'b0;
      done_row_q   <= {ROW_BITS{1'b0}};
      done_last_q  <= 1'b0;
    end else begin
      slot_done_q <= slot_end;
      if (slot_end) begin
        done_row_q  <= row_q;
        done_last_q <= last_row;
      end
      if (slot_start) begin
        active_q     <= 1'b1;
        row_select_q <= {{(ROWS-1){1'b0}}, 1'b1} << next_row;
        settle_q     <= 1'b1;
        clocks_q     <= SETTLE_LOAD[CLK_BITS-1:0];
        row_q        <= next_row;
      end else if (!enable_i) begin
        active_q     <= 1'b0;
        row_select_q <= {ROWS{1'b0}};
        preset_q     <= 1'b1;
        settle_q     <= 1'b1;
      end else if (expired) begin
        preset_q     <= 1'b0;
        settle_q     <= 1'b0;
        clocks_q     <= GATE_LOAD[CLK_BITS-1:0];
      end else begin
        clocks_q     <= clocks_q - 1'b1;
      end
    end

  assign row_select_o = row_select_q;
  assign preset_o     = preset_q;
  assign gate_o       = ~settle_q;
  assign slot_done_o  = slot_done_q;
  assign done_row_o   = done_row_q;
  assign done_last_o  = done_last_q;

endmodule

`default_nettype wire
