// SPDX-License-Identifier: Apache-2.0
// Theorems of the self-test: a mask bit is set by its fault and nothing else, and stays until a self-test frame begins.
// Interface: rows, columns, counts and limits are free at every clock.
// Timing: one step is one clock.
// Why one free column and one free row: mask bits are independent.
`default_nettype none

module check_self_test #(
  parameter ROWS      = 4,
  parameter COLS      = 5,
  parameter CODE_BITS = 8
) (
  input wire               clk_i,
  input wire               rst_ni,
  input wire               enable_i,
  input wire               test_i,
  input wire               test_pending_i,
  input wire               row_valid_i,
  input wire               first_i,
  input wire               test_frame_i,
  input wire               busy_i,
  input wire               end_i,
  input wire [ROWS-1:0]    row_fault_i,
  input wire               column_valid_i,
  input wire [6:0]         column_i,
  input wire [CODE_BITS:0] column_count_i,
  input wire [7:0]         column_slot_i,
  input wire [CODE_BITS:0] test_count_i,
  input wire [15:0]        dark_max_i,
  input wire [15:0]        full_min_i
);

  wire [COLS-1:0] inject_fault;
  wire [COLS-1:0] dark_fault;
  wire [COLS-1:0] full_fault;
  wire [ROWS-1:0] row_fault;
  wire            fault;
  wire            done;
  wire            cut;

  dermis_self_test #(.ROWS (ROWS), .COLS (COLS), .CODE_BITS (CODE_BITS)) u_dut (
    .clk_i          (clk_i),
    .rst_ni         (rst_ni),
    .enable_i       (enable_i),
    .test_i         (test_i),
    .test_pending_i (test_pending_i),
    .row_valid_i    (row_valid_i),
    .first_i        (first_i),
    .test_frame_i   (test_frame_i),
    .busy_i         (busy_i),
    .end_i          (end_i),
    .row_fault_i    (row_fault_i),
    .column_valid_i (column_valid_i),
    .column_i       (column_i),
    .column_count_i (column_count_i),
    .column_slot_i  (column_slot_i),
    .test_count_i   (test_count_i),
    .dark_max_i     (dark_max_i),
    .full_min_i     (full_min_i),
    .inject_fault_o (inject_fault),
    .dark_fault_o   (dark_fault),
    .full_fault_o   (full_fault),
    .row_fault_o    (row_fault),
    .fault_o        (fault),
    .done_o         (done),
    .cut_o          (cut)
  );

  (* anyconst *) wire [6:0] one;
  (* anyconst *) wire [6:0] row;

  reg started_q = 1'b0;
  reg inject_q;
  reg dark_q;
  reg full_q;
  reg row_q;
  reg done_q;
  // A request without a frame since.
  reg newer_q;
  wire tap_latest;
  wire tap_asked;
  wire tap_stopped;
  // Of the latest request: it waits for its result, its enable fell, and it was told so.
  reg asked_q;
  reg fell_q;
  reg cut_q;
  wire begins = row_valid_i & first_i & test_frame_i;
  wire mine   = column_valid_i & (column_i == one);
  // Full scale of the even columns is slot F2, of the odd ones F3; a column has current in its own.
  wire even   = ~one[0];
  wire lit    = even ? column_slot_i == 8'hF2 : column_slot_i == 8'hF3;
  wire unlit  = even ? column_slot_i == 8'hF3 : column_slot_i == 8'hF2;

  always @(posedge clk_i) started_q <= 1'b1;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) {inject_q, dark_q, full_q, row_q, done_q, newer_q} <= 6'b000001;
    else begin
      if (begins) {inject_q, dark_q, full_q} <= 3'd0;
      else if (mine) begin
        if (column_slot_i == 8'hF0 && column_count_i != test_count_i) inject_q <= 1'b1;
        if (column_slot_i == 8'hF1 && column_count_i > dark_max_i)    dark_q   <= 1'b1;
        if (unlit && column_count_i > dark_max_i)                     dark_q   <= 1'b1;
        if (lit && column_count_i < full_min_i)                       full_q   <= 1'b1;
      end
      if (row_valid_i) row_q <= row_fault_i[row] | (row_q & ~begins);
      if (test_i || begins) done_q <= 1'b0;
      else if (end_i && test_frame_i && !newer_q) done_q <= 1'b1;
      newer_q <= test_i | (begins ? test_pending_i : newer_q);
    end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) {asked_q, fell_q, cut_q} <= 3'b000;
    else if (test_i) {asked_q, fell_q, cut_q} <= {enable_i, 1'b0, !enable_i};
    else if (end_i && test_frame_i && !newer_q) {asked_q, fell_q} <= 2'b00;
    else begin
      if (asked_q && !enable_i) fell_q <= 1'b1;
      if (asked_q && fell_q && !busy_i) {asked_q, cut_q} <= 2'b01;
    end

  always @* begin
    if (!started_q) assume (!rst_ni);
    assume (one < COLS && row < ROWS);
    injects: assert (inject_fault[one] == inject_q);
    darkness: assert (dark_fault[one] == dark_q);
    full_scale: assert (full_fault[one] == full_q);
    rows: assert (row_fault[row] == row_q);
    any_of_them: assert (fault == (inject_fault != 0 || dark_fault != 0 || full_fault != 0 || row_fault != 0));
    ends: assert (done == done_q);
    tells_a_cut: assert (cut == cut_q);
    lemma_latest: assert (tap_latest == !newer_q);
    lemma_asked: assert (tap_asked == asked_q && (!asked_q || tap_stopped == fell_q));

    finds_all: cover (rst_ni && inject_q && dark_q && full_q && row_q && done_q);
    tells: cover (rst_ni && cut && !done);
    clears: cover (rst_ni && started_q && row_valid_i && begins && dark_q && !fault == 1'b0 && done_q);
  end

endmodule

`default_nettype wire
