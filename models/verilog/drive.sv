// SPDX-License-Identifier: Apache-2.0
// Time dependence (supply, motion): means of all functions of time over each clock of a slot, from basis.bin, preceded
// by their values at the start of the row. A column current is a sum of them with its own coefficients (course.sv).
// Interface: basis_o and basis_begin_o hold TERMS doubles; frame_start_o is high in the first clock of row 0, dark_o
// while no row is driven.
// Timing: a slot begins with preset, its row follows BREAK_CLOCKS later. The first slot after a pause has no break.
`default_nettype none

module drive #(
  parameter TERMS        = 2,
  parameter SLOT_CLOCKS  = 625,
  parameter BREAK_CLOCKS = 0
) (
  input  wire                clk_i,
  input  wire                preset_i,
  input  wire                driven_i,
  input  wire                first_row_i,
  output wire [64*TERMS-1:0] basis_o,
  output wire [64*TERMS-1:0] basis_begin_o,
  output wire                frame_start_o,
  output wire                dark_o
);

  localparam CLOCK_BITS = $clog2(SLOT_CLOCKS + 1);

  wire                  settling;
  wire                  row_start;
  wire                  break_start;
  reg                   preset_q;
  reg                   settling_q;
  reg  [CLOCK_BITS-1:0] clock_q;
  wire [CLOCK_BITS-1:0] now;

  assign settling      = preset_i & driven_i;
  assign dark_o        = ~driven_i;
  assign row_start     = settling & ~settling_q;
  assign break_start   = preset_i & ~preset_q & dark_o;
  assign frame_start_o = row_start & first_row_i;
  assign now           = row_start ? BREAK_CLOCKS[CLOCK_BITS-1:0] : break_start ? {CLOCK_BITS{1'b0}} : clock_q;

  initial begin
    preset_q   = 1'b0;
    settling_q = 1'b0;
    clock_q    = {CLOCK_BITS{1'b0}};
  end
  always @(posedge clk_i) begin
    preset_q   <= preset_i;
    settling_q <= settling;
    if (now != SLOT_CLOCKS[CLOCK_BITS-1:0]) clock_q <= now + 1'b1;
  end

  generate
    if (TERMS > 1) begin : gen_basis
      integer    file;
      integer    got;
      integer    n;
      integer    t;
      reg [63:0] word;
      reg [64*TERMS-1:0] begin_q;
      reg [64*TERMS-1:0] table_q [0:SLOT_CLOCKS-1];
      initial begin
        file = $fopen("basis.bin", "rb");
        for (n = -1; n < SLOT_CLOCKS; n = n + 1)
          for (t = 0; t < TERMS; t = t + 1) begin
            got = $fread(word, file);
            if (got != 8) $fatal(1, "basis.bin ends early, in clock %0d", n);
            if (n < 0) begin_q[64*t +: 64] = word;
            else table_q[n][64*t +: 64] = word;
          end
        $fclose(file);
      end
      assign basis_o       = table_q[now];
      assign basis_begin_o = begin_q;
    end else begin : gen_constant
      assign basis_o       = $realtobits(1.0);
      assign basis_begin_o = $realtobits(1.0);
    end
  endgenerate

endmodule

`default_nettype wire
