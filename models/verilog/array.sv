// SPDX-License-Identifier: Apache-2.0
// The array as the converters see it: the column currents of the driven row, solved beforehand (dermis.array.array), one frame after the other.
// Interface: row_select_i from the chip; i_column[CELL c] is the current into column c in k i0 (with CELL above 1 what course.sv makes
// a current of), value[N c + n] run-time value n of column c (values.vh), all as the bits of a double and read from outside by name: Icarus 11 has
// no ports that are arrays.
// Timing: i_column changes where a row is driven, which rows never are without a break between them; a frame is read where row 0 is driven.
// Why the edge of a row and not the clock: whatever hangs on these currents alone is then worked out once a slot, not once a clock.
`include "values.vh"
`default_nettype none

module array #(
  parameter ROWS    = 16,
  parameter COLS    = 16,
  parameter CELL    = 1,
  parameter EFFECTS = 0
) (
  input  wire [ROWS-1:0] row_select_i,
  output integer         frames_o
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

  task read_word;
    begin
      got = $fread(word, file);
      if (got != 8) $fatal(1, "currents.bin ends early, in frame %0d", frame);
    end
  endtask

  task read_values;
    for (n = 0; n < COLS*`DERMIS_VALUES; n = n + 1) begin
      read_word;
      value[n] = word;
    end
  endtask

  initial begin
    frame    = 0;
    reading  = 1'b0;
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

endmodule

`default_nettype wire
