// SPDX-License-Identifier: Apache-2.0
// Theorems of the reader with its packer: no row comes before the previous one is packed, so nothing is lost.
// Interface: enable, requests, row mask and settings are free at every clock; the settings within the small ranges below.
// Timing: one step is one clock.
// Why these sizes: only the gate against PACK_CLOCKS matters, 18 here and 21 with two columns of nine
// bits; gates from 1 to 31 are on both sides of it.
`default_nettype none

module check_reader #(
  parameter COLS       = 1,
  parameter CODE_BITS  = 1,
  parameter SYNC_LATCH = 0,
  parameter SETTLE_BITS = 3,
  parameter GATE_BITS = 5
) (
  input wire                   clk_i,
  input wire                   rst_ni,
  input wire                   enable_i,
  input wire                   continuous_i,
  input wire                   shot_i,
  input wire                   test_i,
  input wire                   dark_i,
  input wire [1:0]             pedestal_mode_i,
  input wire [SETTLE_BITS-1:0] settle_i,
  input wire [GATE_BITS-1:0]   gate_i,
  input wire                   row_mask_i
);

  wire        row_valid;
  wire [7:0]  slot;
  wire        first;
  wire        last;
  wire        test_frame;
  wire        dark_frame;
  wire [15:0] gate_clocks;
  wire [1:0]  mode;
  wire        shift;
  wire        busy;
  wire [CODE_BITS:0] count;
  wire        opens;
  wire        we;
  wire        closes;
  wire        preset;
  wire [COLS-1:0] charge;

  dermis_reader #(.ROWS (1), .COLS (COLS), .CODE_BITS (CODE_BITS), .BREAK_CLOCKS (1), .SYNC_LATCH (SYNC_LATCH)) u_reader (
    .clk_i          (clk_i),
    .rst_ni         (rst_ni),
    .enable_i       (enable_i),
    .continuous_i   (continuous_i),
    .shot_i         (shot_i),
    .test_i         (test_i),
    .dark_i         (dark_i),
    .hold_i         (1'b0),
    .pedestal_mode_i (pedestal_mode_i),
    .settle_i       ({{(16-SETTLE_BITS){1'b0}}, settle_i}),
    .gate_i         ({{(16-GATE_BITS){1'b0}}, gate_i}),
    .row_mask_i     (row_mask_i),
    .range_i        ({(2*COLS){1'b0}}),
    .test_rate_i    (16'h4000),
    .comp_async_i   ({COLS{1'b0}}),
    .row_sense_i    (1'b0),
    .row_select_o   (),
    .preset_o       (preset),
    .charge_o       (charge),
    .range_o        (),
    .test_current_o (),
    .frame_start_o  (),
    .scanning_o     (),
    .working_o      (),
    .busy_i         (busy),
    .row_valid_o    (row_valid),
    .slot_o         (slot),
    .first_o        (first),
    .last_o         (last),
    .test_frame_o   (test_frame),
    .dark_frame_o   (dark_frame),
    .pedestal_mode_o (mode),
    .gate_clocks_o  (gate_clocks),
    .count_shift_i  (shift),
    .count_o        (count),
    .test_count_o   (),
    .row_fault_o    ()
  );

  dermis_packer #(.COLS (COLS), .CODE_BITS (CODE_BITS)) u_packer (
    .clk_i           (clk_i),
    .rst_ni          (rst_ni),
    .row_valid_i     (row_valid),
    .slot_i          (slot),
    .first_i         (first),
    .last_i          (last),
    .test_frame_i    (test_frame),
    .dark_frame_i    (dark_frame),
    .gate_clocks_i   (gate_clocks),
    .count_i         (count),
    .count_shift_o   (shift),
    .busy_o          (busy),
    .pedestal_mode_i (mode),
    .pedestal_i      ({(COLS*CODE_BITS){1'b0}}),
    .fault_i         (1'b0),
    .frame_number_o  (),
    .begin_o         (opens),
    .we_o            (we),
    .byte_o          (),
    .end_o           (closes),
    .underflow_o     (),
    .column_valid_o  (),
    .column_o        (),
    .column_count_o  (),
    .column_slot_o   ()
  );

  reg        started_q = 1'b0;
  reg        open_q;
  reg        busy_q;
  reg [29:0] row_q;
  reg [15:0] gates_q;
  always @(posedge clk_i) begin
    started_q <= 1'b1;
    busy_q    <= busy & rst_ni;
    row_q     <= {mode, slot, first, last, test_frame, dark_frame, gate_clocks};
  end
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) open_q <= 1'b0;
    else         open_q <= (open_q | opens) & ~closes;

  always @* begin
    if (!started_q) assume (!rst_ni);
    if (row_valid) nothing_is_lost: assert (!busy);
    if (opens) ends_before_the_next: assert (!closes);
    if (started_q && busy_q && (busy || closes) && rst_ni) row_rests: assert (row_q == {mode, slot, first, last, test_frame, dark_frame, gate_clocks});
    if (we || closes) bytes_inside_a_frame: assert (open_q);

    never_two_frames: assert (!(closes && gate_clocks == 16'd1 && row_q[7:0] == 8'd1));
    never_long_gate: assert (!(row_valid && gate_clocks == 16'd19));
  end

endmodule

`default_nettype wire
