// SPDX-License-Identifier: Apache-2.0
// Array as seen by the converters: column currents of the driven row, solved beforehand (dermis.array.array).
// Interface: row_select_i from the chip; i_column[CELL c] is the current into column c in k i0 (with CELL above 1 the
// input of course.sv), value[N c + n] run-time value n of column c (values.vh). All are bits of a double, read from
// outside by name: Icarus 11 has no array ports. given_o: what the virtual grounds of others send into each column in
// this clock, worked out from grounds_i (integrator.sv) when give_i rises (docs/event.md, "Coupled columns").
// Timing: i_column changes at the edge of a row; rows have a break between them. A frame is read with row 0.
// Why the edge of a row and not the clock: logic that depends only on these currents is evaluated once a slot.
`include "values.vh"
`default_nettype none

module array #(
  parameter ROWS        = 16,
  parameter COLS        = 16,
  parameter CELL        = 1,
  parameter EFFECTS     = 0,
  parameter GATE_CLOCKS = 600
) (
  input  wire [ROWS-1:0]    row_select_i,
  input  wire               give_i,
  input  wire               preset_i,
  input  real               t_clocks,
  input  wire [64*COLS-1:0] grounds_i,
  output reg  [64*COLS-1:0] given_o,
  output integer            frames_o
);

  integer    file;
  integer    frame;
  integer    got;
  integer    n;
  reg        reading;
  reg [63:0] word;
  reg [63:0] i_taxel  [0:ROWS*COLS*CELL-1];
  reg [63:0] i_column [0:COLS*CELL-1];
  reg [63:0] value    [0:COLS*`DERMIS_VALUES-1];
  // packets a clock into column c while the ground of column d is off by one, [c][middle of the gate, change over it][d]
  real       link     [0:2*COLS*COLS-1];

  task read_word;
    begin
      got = $fread(word, file);
      if (got != 8) $fatal(1, "currents.bin ends early, in frame %0d", frame);
    end
  endtask

  task read_values;
    begin
      for (n = 0; n < COLS*`DERMIS_VALUES; n = n + 1) begin
        read_word;
        value[n] = word;
      end
      if (EFFECTS[`DERMIS_COUPLED])
        for (n = 0; n < 2*COLS*COLS; n = n + 1) begin
          read_word;
          link[n] = $bitstoreal(word);
        end
    end
  endtask

  initial begin
    frame    = 0;
    reading  = 1'b0;
    given_o  = {(64*COLS){1'b0}};
    for (n = 0; n < COLS*CELL; n = n + 1) i_column[n] = 64'd0;
    file     = $fopen("currents.bin", "rb");
    read_word;
    frames_o = word[31:0];
    read_values;
  end

  wire driven;
  assign driven = |row_select_i;

  always @(posedge driven) begin
    if (row_select_i[0]) reading = frame < frames_o;
    if (row_select_i[0] && reading) begin
      frame = frame + 1;
      for (n = 0; n < ROWS*COLS*CELL; n = n + 1) begin
        read_word;
        i_taxel[n] = word;
      end
    end
    if (EFFECTS[`DERMIS_EACH_ROW] && reading) read_values;
    for (n = 0; n < ROWS*COLS*CELL; n = n + 1)
      if (row_select_i[n/(COLS*CELL)]) i_column[n%(COLS*CELL)] = i_taxel[n];
  end

  integer c;
  integer d;
  real    from_middle;
  real    sum;
  generate
    if (EFFECTS[`DERMIS_COUPLED]) begin : gen_coupled
      always @(posedge give_i) begin
        from_middle = (t_clocks - 0.5) / GATE_CLOCKS - 0.5;
        for (c = 0; c < COLS; c = c + 1) begin
          sum = 0.0;
          for (d = 0; d < COLS; d = d + 1)
            sum = sum + (link[2*COLS*c + d] + from_middle * link[2*COLS*c + COLS + d]) * $bitstoreal(grounds_i[64*d +: 64]);
          given_o[64*c +: 64] <= preset_i ? 64'd0 : $realtobits(sum);
        end
      end
    end
  endgenerate

endmodule

`default_nettype wire
