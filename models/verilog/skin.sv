// SPDX-License-Identifier: Apache-2.0
// Whole reader: the chip of rtl/, a channel per column, the array and an SPI host; reads currents.bin, writes frames.txt.
// Interface: every change of go_i runs BURST clocks at one instant of simulated time; the rest goes through the files.
// frames.txt has one line per frame: the answer of the chip in hex, from the token to the last byte (docs/spi.md).
// Why the clock is made here: a call of a Verilator model costs as much as a clock. Why nonblocking assignments: each
// level of the clock settles before the next in any simulator.
// TERMS, DARK: docs/rtl_engine.md. TOPOLOGY: 0 direct, 1 conveyor_mirror, 2 conveyor_mirror_inverted, 3 multi_output_conveyor. EFFECTS: values.vh.
`include "dermis_design.vh"
`include "values.vh"
`default_nettype none

module skin #(
  parameter ROWS          = `DERMIS_ROWS,
  parameter COLS          = `DERMIS_COLS,
  parameter CODE_BITS     = `DERMIS_CODE_BITS,
  parameter GATE_CLOCKS   = `DERMIS_GATE_CLOCKS,
  parameter SETTLE_CLOCKS = `DERMIS_SETTLE_CLOCKS,
  parameter BREAK_CLOCKS  = `DERMIS_BREAK_CLOCKS,
  parameter SYNC_LATCH    = 0,
  parameter TOPOLOGY      = 1,
  parameter EFFECTS       = 0,
  parameter TERMS         = 1,
  parameter DARK          = 0,
  parameter BURST         = `DERMIS_SLOT_CLOCKS
) (
  input wire go_i
);

  localparam CELL     = (1 + DARK)*TERMS;
  localparam MEMORY   = (BREAK_CLOCKS > 0) && EFFECTS[`DERMIS_Q_MIRROR];
  localparam VARIES   = (TERMS > 1) || EFFECTS[`DERMIS_Q_MIRROR];

  // Ticks of the host per clock of the chip, so that it reads a frame in less than 0.8 of a frame time. Coupled columns
  // take three: all outputs settle, what the columns give each other changes, and the outputs settle again.
  localparam FRAME_BITS = 8*(24 + ROWS*(1 + COLS*((CODE_BITS > 8) ? 2 : 1) + (COLS + 7)/8));
  localparam TO_READ    = 1 + 5*FRAME_BITS/(2*ROWS*(SETTLE_CLOCKS + GATE_CLOCKS));
  localparam COUPLED    = EFFECTS[`DERMIS_COUPLED];
  localparam TICKS      = (COUPLED && TO_READ < 3) ? 3 : TO_READ;

  reg       tick;
  wire      clk;
  reg       rst_n;
  reg       enable;
  reg [1:0] started_q;
  integer   levels;

  initial begin
    tick      = 1'b0;
    rst_n     = 1'b1;
    enable    = 1'b0;
    started_q = 2'd0;
    levels    = 0;
  end

  always @(posedge go_i or negedge go_i or posedge tick or negedge tick)
    if (levels == 2*TICKS*BURST) levels <= 0;
    else begin
      levels <= levels + 1;
      tick   <= ~tick;
    end

  wire give;
  generate
    if (TICKS == 1) begin : gen_clk_is_tick
      assign clk  = tick;
      assign give = 1'b0;
    end else begin : gen_clk_divided
      reg     clk_q;
      integer ticks_q;
      initial begin
        clk_q   = 1'b0;
        ticks_q = 0;
      end
      always @(posedge tick or negedge tick)
        if (ticks_q == TICKS - 1) begin
          ticks_q <= 0;
          clk_q   <= ~clk_q;
        end else ticks_q <= ticks_q + 1;
      assign clk  = clk_q;
      assign give = !clk_q && ticks_q == 1;
    end
  endgenerate

  // Reset falls with the first falling edge and rises with the second; enable rises with the third.
  always @(negedge clk)
    if (!enable) begin
      started_q <= started_q + 2'd1;
      rst_n     <= started_q != 2'd0;
      enable    <= started_q == 2'd2;
    end

  wire [COLS-1:0]   comp;
  wire [ROWS-1:0]   row_select;
  wire              preset;
  wire [COLS-1:0]   charge;
  wire [2*COLS-1:0] range_unused;
  wire [COLS-1:0]   test_current_unused;
  wire              frame_start_unused;
  wire              sck;
  wire              cs_n;
  wire              copi;
  wire              cipo;
  wire              cipo_oe_unused;
  wire              frame_ready;
  integer           frames;

  dermis_top #(
    .ROWS          (ROWS),
    .COLS          (COLS),
    .CODE_BITS     (CODE_BITS),
    .GATE_CLOCKS   (GATE_CLOCKS),
    .SETTLE_CLOCKS (SETTLE_CLOCKS),
    .BREAK_CLOCKS  (BREAK_CLOCKS),
    .SYNC_LATCH    (SYNC_LATCH)
  ) u_top (
    .clk_i          (clk),
    .rst_ni         (rst_n),
    .enable_i       (enable),
    .comp_async_i   (comp),
    .row_sense_i    (row_select),
    .row_select_o   (row_select),
    .preset_o       (preset),
    .charge_o       (charge),
    .range_o        (range_unused),
    .test_current_o (test_current_unused),
    .frame_start_o  (frame_start_unused),
    .spi_sck_i      (sck),
    .spi_cs_ni      (cs_n),
    .spi_copi_i     (copi),
    .spi_cipo_o     (cipo),
    .spi_cipo_oe_o  (cipo_oe_unused),
    .frame_ready_o  (frame_ready)
  );

  wire [7:0] host_byte;
  wire       host_valid;
  wire       host_done;

  spi_host u_host (
    .clk_i         (tick),
    .rst_ni        (rst_n),
    .frame_ready_i (frame_ready),
    .sck_o         (sck),
    .cs_no         (cs_n),
    .copi_o        (copi),
    .cipo_i        (cipo),
    .byte_o        (host_byte),
    .byte_valid_o  (host_valid),
    .done_o        (host_done)
  );

  real               t_clocks;
  wire [64*COLS-1:0] grounds;
  wire [64*COLS-1:0] given;

  array #(.ROWS(ROWS), .COLS(COLS), .CELL(CELL), .EFFECTS(EFFECTS), .GATE_CLOCKS(GATE_CLOCKS)) u_array (
    .row_select_i (row_select),
    .give_i       (give),
    .preset_i     (preset),
    .t_clocks     (t_clocks),
    .grounds_i    (grounds),
    .given_o      (given),
    .frames_o     (frames)
  );

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
      real                         i_mean;
      real                         i_in;
      real                         i_begin;
      // In two steps: Icarus 11 writes an unreadable program for $bitstoreal of a word of an array.
      for (v = 0; v < CELL; v = v + 1) begin : gen_cell
        assign i_bits[64*v +: 64] = u_array.i_column[CELL*c + v];
      end
      course #(.TERMS(TERMS), .MEMORY(MEMORY), .DARK(DARK)) u_course (
        .dark_i        (dark),
        .cell_i        (i_bits),
        .basis_i       (basis),
        .basis_begin_i (basis_begin),
        .i_mean        (i_mean),
        .i_begin       (i_begin)
      );
      for (v = 0; v < `DERMIS_VALUES; v = v + 1) begin : gen_value
        assign values_c[64*v +: 64] = u_array.value[`DERMIS_VALUES*c + v];
      end
      if (COUPLED) begin : gen_coupled
        assign grounds[64*c +: 64] = $realtobits(gen_direct.u_channel.u_vfc.u_integrator.gen_bent.gen_coupled.ground);
        assign i_in                = i_mean + $bitstoreal(given[64*c +: 64]);
      end else begin : gen_alone
        assign grounds[64*c +: 64] = 64'd0;
        assign i_in                = i_mean;
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
    file = $fopen("frames.txt", "w");
  end
  always @(posedge tick) begin
    if (host_valid) $fwrite(file, "%h", host_byte);
    if (host_done) begin
      $fwrite(file, "\n");
      $fflush(file);
      done <= done + 1;
      if (done + 1 == frames) begin
        $fclose(file);
        $finish;
      end
    end
  end

endmodule

`default_nettype wire
