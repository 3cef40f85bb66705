// SPDX-License-Identifier: Apache-2.0
// The whole reader: the chip of rtl/ as it is, a channel a column and the array, reading currents.bin and writing codes.txt.
// Interface: every change of go_i runs BURST clocks, all at one instant of simulated time; nothing else goes in or out but the two files.
// Why the clock is made here: leaving and entering a Verilator model costs as much as a clock of it. Why with nonblocking assignments: each
// level of the clock has settled before the next, in any simulator.
// TERMS, MODES, DARK: docs/rtl_engine.md. TOPOLOGY: 0 direct, 1 conveyor_mirror, 2 conveyor_mirror_inverted, 3 multi_output_conveyor. EFFECTS: values.vh.
`include "dermis_design.vh"
`include "values.vh"
`default_nettype none

module skin #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter COLS          = `DERMIS_COLS,
  parameter CODE_BITS     = `DERMIS_CODE_BITS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter SYNC_LATCH    = 0,
  parameter TOPOLOGY      = 1,
  parameter EFFECTS       = 0,
  parameter TERMS         = 1,
  parameter MODES         = 0,
  parameter DARK          = 0,
  parameter BREAK_CLOCKS  = 0,
  parameter BURST         = `DERMIS_SLOT_CLOCKS
) (
  input wire go_i
);

  localparam CELL     = (1 + DARK)*TERMS + 2*MODES;
  localparam MEMORY   = (BREAK_CLOCKS > 0) && EFFECTS[`DERMIS_Q_MIRROR];
  localparam VARIES   = (TERMS > 1) || (MODES > 0) || EFFECTS[`DERMIS_Q_MIRROR];
  localparam ROW_BITS = (ROWS > 1) ? $clog2(ROWS) : 1;

  reg       clk;
  reg       rst_n;
  reg       enable;
  reg [1:0] started_q;
  integer   levels;

  initial begin
    clk       = 1'b0;
    rst_n     = 1'b1;
    enable    = 1'b0;
    started_q = 2'd0;
    levels    = 0;
  end

  always @(posedge go_i or negedge go_i or posedge clk or negedge clk)
    if (levels == 2*BURST) levels <= 0;
    else begin
      levels <= levels + 1;
      clk    <= ~clk;
    end

  // Reset falls with the first falling edge and rises with the second; enable rises with the third.
  always @(negedge clk)
    if (!enable) begin
      started_q <= started_q + 2'd1;
      rst_n     <= started_q != 2'd0;
      enable    <= started_q == 2'd2;
    end

  wire [COLS-1:0]           comp;
  wire [ROWS-1:0]           row_select;
  wire                      preset;
  wire [COLS-1:0]           charge;
  wire [COLS*CODE_BITS-1:0] codes;
  wire [ROW_BITS-1:0]       codes_row;
  wire                      codes_valid;
  wire                      frame_done;
  integer                   frames;

  dermis_top #(
    .ROWS          (ROWS),
    .COLS          (COLS),
    .CODE_BITS     (CODE_BITS),
    .GATE_CLOCKS   (GATE_CLOCKS),
    .SETTLE_CLOCKS (SETTLE_CLOCKS),
    .SYNC_LATCH    (SYNC_LATCH)
  ) u_top (
    .clk_i         (clk),
    .rst_ni        (rst_n),
    .enable_i      (enable),
    .comp_async_i  (comp),
    .row_select_o  (row_select),
    .preset_o      (preset),
    .charge_o      (charge),
    .codes_o       (codes),
    .codes_row_o   (codes_row),
    .codes_valid_o (codes_valid),
    .frame_done_o  (frame_done)
  );

  array #(.ROWS(ROWS), .COLS(COLS), .CELL(CELL), .EFFECTS(EFFECTS)) u_array (
    .row_select_i (row_select),
    .preset_i     (preset),
    .frames_o     (frames)
  );

  real t_clocks;
  always @(posedge clk) t_clocks <= preset ? 1.0 : t_clocks + 1.0;

  wire [64*TERMS-1:0] basis;
  wire [64*TERMS-1:0] basis_begin;
  wire                frame_start;
  wire                dark;
  generate
    if (VARIES) begin : gen_drive
      drive #(.TERMS(TERMS), .SLOT_CLOCKS(SETTLE_CLOCKS + GATE_CLOCKS), .BREAK_CLOCKS(BREAK_CLOCKS)) u_drive (
        .clk_i         (clk),
        .preset_i      (preset),
        .driven_i      (|row_select),
        .first_row_i   (row_select[0]),
        .basis_o       (basis),
        .basis_begin_o (basis_begin),
        .frame_start_o (frame_start),
        .dark_o        (dark)
      );
    end else begin : gen_still
      assign basis       = {(64*TERMS){1'b0}};
      assign basis_begin = {(64*TERMS){1'b0}};
      assign frame_start = 1'b0;
      assign dark        = 1'b0;
    end
  endgenerate

  genvar c;
  genvar v;
  generate
    for (c = 0; c < COLS; c = c + 1) begin : gen_column
      wire [64*CELL-1:0]           i_bits;
      wire [64*`DERMIS_VALUES-1:0] values_c;
      real                         i_in;
      real                         i_begin;
      // Not at once: Icarus 11 writes a program that it cannot read where $bitstoreal takes a word of an array.
      for (v = 0; v < CELL; v = v + 1) begin : gen_cell
        assign i_bits[64*v +: 64] = u_array.i_column[CELL*c + v];
      end
      course #(.TERMS(TERMS), .MODES(MODES), .MEMORY(MEMORY), .DARK(DARK)) u_course (
        .clk_i         (clk),
        .preset_i      (preset),
        .dark_i        (dark),
        .cell_i        (i_bits),
        .basis_i       (basis),
        .basis_begin_i (basis_begin),
        .i_mean        (i_in),
        .i_begin       (i_begin)
      );
      for (v = 0; v < `DERMIS_VALUES; v = v + 1) begin : gen_value
        assign values_c[64*v +: 64] = u_array.value[`DERMIS_VALUES*c + v];
      end
      if (TOPOLOGY == 0) begin : gen_direct
        channel_direct #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_channel (
          .clk_i(clk), .t_clocks(t_clocks), .frame_start_i(frame_start), .col(i_in), .col_begin(i_begin),
          .d_charge(charge[c]), .d_preset(preset), .values_i(values_c), .comp(comp[c])
        );
      end else if (TOPOLOGY == 1) begin : gen_conveyor_mirror
        channel_conveyor_mirror #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_channel (
          .clk_i(clk), .t_clocks(t_clocks), .frame_start_i(frame_start), .col(i_in), .col_begin(i_begin),
          .d_charge(charge[c]), .d_preset(preset), .values_i(values_c), .comp(comp[c])
        );
      end else if (TOPOLOGY == 2) begin : gen_conveyor_mirror_inverted
        channel_conveyor_mirror_inverted #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_channel (
          .clk_i(clk), .t_clocks(t_clocks), .frame_start_i(frame_start), .col(i_in), .col_begin(i_begin),
          .d_charge(charge[c]), .d_preset(preset), .values_i(values_c), .comp(comp[c])
        );
      end else begin : gen_multi_output_conveyor
        channel_multi_output_conveyor #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_channel (
          .clk_i(clk), .t_clocks(t_clocks), .frame_start_i(frame_start), .col(i_in), .col_begin(i_begin),
          .d_charge(charge[c]), .d_preset(preset), .values_i(values_c), .comp(comp[c])
        );
      end
    end
  endgenerate

  integer file;
  integer done;
  initial begin
    done = 0;
    file = $fopen("codes.txt", "w");
  end
  always @(posedge codes_valid) begin
    $fwrite(file, "%h %h\n", codes_row, codes);
    if (frame_done) begin
      done <= done + 1;
      if (done + 1 == frames) begin
        $fclose(file);
        $finish;
      end
    end
  end

endmodule

`default_nettype wire
