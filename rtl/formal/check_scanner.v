// SPDX-License-Identifier: Apache-2.0
// Theorems of the slot sequencer: one row, break before make, exact slot times, slots in order, no deadlock, one shot one frame.
// Interface: every input is free at every clock: enable, requests, all 16 bits of settle and gate, the row mask, busy.
// Timing: one step is one clock; since_q is 0 in the clock after e0.
// Why the reference counts up and the design down: it is the timing table of docs/rtl.md, not a copy of the design.
`default_nettype none

module check_scanner #(
  parameter ROWS         = 16,
  parameter BREAK_CLOCKS = 1,
  parameter PACK_CLOCKS  = 34
) (
  input wire            clk_i,
  input wire            rst_ni,
  input wire            enable_i,
  input wire            continuous_i,
  input wire            shot_i,
  input wire            test_i,
  input wire            dark_i,
  input wire            hold_i,
  input wire [1:0]      pedestal_mode_i,
  input wire [15:0]     settle_i,
  input wire [15:0]     gate_i,
  input wire [ROWS-1:0] row_mask_i,
  input wire            busy_i
);

  localparam SLOTS = ROWS + 4;
  localparam SHORTEST = BREAK_CLOCKS + 2;

  wire [ROWS-1:0] row_select;
  wire            preset;
  wire            gate;
  wire            inject;
  wire            full_even;
  wire            full_odd;
  wire            frame_load;
  wire            frame_start;
  wire            scanning;
  wire            slot_end;
  wire            slot_done;
  wire [7:0]      done_slot;
  wire            done_first;
  wire            done_last;
  wire            done_test;
  wire            done_dark;
  wire [1:0]      done_mode;
  wire [15:0]     done_gate;

  dermis_row_scanner #(
    .ROWS         (ROWS),
    .BREAK_CLOCKS (BREAK_CLOCKS),
    .PACK_CLOCKS  (PACK_CLOCKS)
  ) u_dut (
    .clk_i         (clk_i),
    .rst_ni        (rst_ni),
    .enable_i      (enable_i),
    .continuous_i  (continuous_i),
    .shot_i        (shot_i),
    .test_i        (test_i),
    .dark_i        (dark_i),
    .hold_i        (hold_i),
    .pedestal_mode_i (pedestal_mode_i),
    .settle_i      (settle_i),
    .gate_i        (gate_i),
    .row_mask_i    (row_mask_i),
    .busy_i        (busy_i),
    .row_select_o  (row_select),
    .preset_o      (preset),
    .gate_o        (gate),
    .inject_o      (inject),
    .full_even_o   (full_even),
    .full_odd_o    (full_odd),
    .frame_load_o  (frame_load),
    .frame_start_o (frame_start),
    .scanning_o    (scanning),
    .slot_end_o    (slot_end),
    .slot_done_o   (slot_done),
    .done_slot_o   (done_slot),
    .done_first_o  (done_first),
    .done_last_o   (done_last),
    .done_test_o   (done_test),
    .done_dark_o   (done_dark),
    .done_mode_o   (done_mode),
    .done_gate_o   (done_gate)
  );

  // Internal signals, for the induction and for the rest of a slot.
  wire [15:0]      tap_clocks;
  wire             tap_break;
  wire             tap_short;
  wire [15:0]      tap_settle;
  wire [15:0]      tap_gate;
  wire [SLOTS-1:0] tap_slots;
  wire             tap_shot;
  wire             tap_test;
  wire             tap_test_frame;
  wire             tap_dark_frame;
  wire             tap_first;
  wire [1:0]       tap_mode;

  // Clocks left in this slot, from counter and settings of the design.
  wire [17:0] left = tap_break ? 18'd2 + tap_clocks + tap_settle + tap_gate
                   : preset    ? 18'd1 + tap_clocks + tap_gate
                   :             18'd1 + tap_clocks;
  reg  [17:0]      left_q;
  reg  [SLOTS-1:0] slots_q;
  reg              scanning_q;
  reg              slot_end_q;
  reg              load_q;
  reg              waits_q;

  reg started_q = 1'b0;
  always @(posedge clk_i) started_q <= 1'b1;

  // Reference.
  reg             run_q;
  reg             gating_q;
  reg [15:0]      since_q;
  reg [15:0]      gated_q;
  reg [15:0]      settle_q;
  reg [15:0]      gate_q;
  reg             short_q;
  reg [SLOTS-1:0] list_q;
  reg             first_q;
  reg             shot_q;
  reg             test_q;
  reg             test_frame_q;
  reg             dark_frame_q;
  reg [1:0]       mode_q;

  wire [SLOTS-1:0] rest   = list_q & (list_q - 1'b1);
  wire [SLOTS-1:0] lowest = list_q & ~rest;
  wire [SLOTS-1:0] list   = {row_mask_i, test_q, test_q, dark_i | test_q, test_q};
  wire             ended  = run_q & gating_q & (gated_q == gate_q - 16'd1);
  wire             whole  = ended & (rest == 0);
  wire             begins = enable_i & ~hold_i & (continuous_i | shot_q | test_q) & (list != 0) & (~run_q | whole);

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      run_q        <= 1'b0;
      gating_q     <= 1'b0;
      since_q      <= 16'd0;
      gated_q      <= 16'd0;
      settle_q     <= 16'd0;
      gate_q       <= 16'd0;
      short_q      <= 1'b0;
      list_q       <= {SLOTS{1'b0}};
      first_q      <= 1'b0;
      shot_q       <= 1'b0;
      test_q       <= 1'b0;
      test_frame_q <= 1'b0;
      dark_frame_q <= 1'b0;
      mode_q       <= 2'd0;
    end else begin
      shot_q <= enable_i & (shot_i | (shot_q & ~(begins & ~test_q)));
      test_q <= enable_i & (test_i | (test_q & ~begins));
      if (begins) begin
        settle_q     <= (settle_i > SHORTEST) ? settle_i : SHORTEST;
        gate_q       <= (gate_i == 0) ? 16'd1 : gate_i;
        short_q      <= (gate_i < PACK_CLOCKS);
        test_frame_q <= test_q;
        dark_frame_q <= dark_i | test_q;
        mode_q       <= pedestal_mode_i;
        first_q      <= 1'b1;
      end else if (ended) first_q <= 1'b0;
      if (begins || (ended && enable_i && rest != 0)) begin
        run_q    <= 1'b1;
        gating_q <= 1'b0;
        since_q  <= 16'd0;
        list_q   <= begins ? list : rest;
      end else if (ended || !enable_i) begin
        run_q    <= 1'b0;
        gating_q <= 1'b0;
      end else if (run_q && gating_q) begin
        gated_q  <= gated_q + 16'd1;
      end else if (run_q && since_q != settle_q - 16'd1) begin
        since_q  <= since_q + 16'd1;
      end else if (run_q && !(busy_i && short_q)) begin
        gating_q <= 1'b1;
        gated_q  <= 16'd0;
      end
    end

  // Values one clock ago.
  reg [ROWS-1:0] row_select_q;
  reg [7:0]      dark_clocks_q;
  reg            ended_q;
  reg            enable_q;
  reg            begins_q;
  reg            out_of_reset_q;
  reg [7:0]      slot_q;
  reg [5:0]      flags_q;
  reg [15:0]     slot_gate_q;
  integer        r;

  always @(posedge clk_i) begin
    out_of_reset_q <= rst_ni;
    left_q         <= left;
    slots_q        <= tap_slots;
    scanning_q     <= scanning;
    slot_end_q     <= slot_end;
    load_q         <= frame_load;
    waits_q        <= preset & ~tap_break & (tap_clocks == 16'd0) & tap_short & busy_i;
    row_select_q   <= row_select;
    ended_q        <= ended;
    enable_q       <= enable_i;
    begins_q       <= begins;
    flags_q        <= {first_q, rest == 0, test_frame_q, dark_frame_q, mode_q};
    slot_gate_q    <= gate_q;
    for (r = 0; r < ROWS; r = r + 1)
      if (lowest[r + 4]) slot_q <= r[7:0];
    if (lowest[0]) slot_q <= 8'hF0;
    if (lowest[1]) slot_q <= 8'hF1;
    if (lowest[2]) slot_q <= 8'hF2;
    if (lowest[3]) slot_q <= 8'hF3;
    // Clocks without a row, saturated.
    if (row_select != 0)                   dark_clocks_q <= 8'd0;
    else if (!started_q)                   dark_clocks_q <= 8'd1;
    else if (dark_clocks_q < BREAK_CLOCKS) dark_clocks_q <= dark_clocks_q + 8'd1;
  end
  wire settled = started_q & out_of_reset_q & rst_ni;

  always @* begin
    if (!started_q) assume (!rst_ni);

    one_row: assert ((row_select & (row_select - 1'b1)) == 0);
    if (started_q && row_select != 0 && row_select_q == 0) break_before_make: assert (dark_clocks_q >= BREAK_CLOCKS);
    if (started_q && row_select != 0 && row_select_q != 0) row_never_changes: assert (row_select == row_select_q);
    if (settled && row_select != row_select_q) rows_move_in_preset: assert (preset);
    preset_without_gate: assert (preset == !(run_q && gating_q) && gate == !preset && scanning == run_q);
    row_of_the_slot: assert (row_select == ((run_q && (gating_q || since_q >= BREAK_CLOCKS)) ? lowest[SLOTS-1:4] : {ROWS{1'b0}}));
    special_slots: assert ({full_odd, full_even, inject} == (run_q ? {lowest[3:2], lowest[0]} : 3'b000));
    slot_ends: assert (slot_end == ended);
    frame_starts: assert (frame_load == begins);
    if (settled && !enable_q) cut_at_once: assert (row_select == 0 && preset && !scanning);
    if (settled) delivers: assert (slot_done == ended_q && (!ended_q
      || (done_slot == slot_q && {done_first, done_last, done_test, done_dark, done_mode} == flags_q && done_gate == slot_gate_q)));
    if (settled) marks_the_frame: assert (frame_start == begins_q);

    // No deadlock: the clocks of a slot fall by one except while busy, and each slot removes one from a finite list.
    if (settled && scanning && scanning_q && !slot_end_q) slot_is_bounded: assert (left_q > 1 && left == left_q - !waits_q);
    if (settled && slot_end) slot_ends_when_none_is_left: assert (left == 1);
    if (settled && scanning) list_is_not_empty: assert (tap_slots != 0 && (!scanning_q || load_q
      || tap_slots == (slot_end_q ? slots_q & (slots_q - 1'b1) : slots_q)));
    if (settled && enable_q && enable_i && !hold_i && (continuous_i || shot_q || test_q) && list != 0) always_scans: assert (scanning || frame_load);
    // One request, one frame: without continuous a frame only begins for a pending request, which it consumes.
    if (settled && frame_load && !continuous_i) one_request_one_frame: assert (tap_test || tap_shot);

    // For the induction.
    lemma_settings: assert (!run_q || (tap_settle == settle_q - BREAK_CLOCKS - 16'd1 && tap_gate == gate_q && tap_short == short_q
      && settle_q >= SHORTEST && gate_q != 0));
    lemma_list: assert (!run_q || (tap_slots == list_q && tap_first == first_q && tap_test_frame == test_frame_q && tap_dark_frame == dark_frame_q && tap_mode == mode_q));
    lemma_requests: assert (tap_shot == shot_q && tap_test == test_q);
    lemma_break: assert (tap_break == (run_q && !gating_q && since_q < BREAK_CLOCKS));
    lemma_clocks: assert (!run_q || tap_clocks == (gating_q ? gate_q - 16'd1 - gated_q
      : tap_break ? BREAK_CLOCKS - 16'd1 - since_q : settle_q - 16'd1 - since_q));
    lemma_dark: assert (!started_q || !run_q || gating_q || since_q > BREAK_CLOCKS || dark_clocks_q >= since_q);
    lemma_dark_clocks: assert (!started_q || dark_clocks_q <= BREAK_CLOCKS);

    test_frame_ends: cover (settled && slot_done && done_last && done_test && done_slot == 8'd1);
    second_row: cover (settled && row_select == 2 && gating_q && !test_frame_q);
    stretched: cover (settled && run_q && !gating_q && since_q == settle_q - 16'd1 && busy_i && short_q && row_select == 2);
    cut_and_delivered: cover (settled && ended_q && !enable_q);
    shot_runs_once: cover (settled && ended_q && !scanning && enable_q && !continuous_i);
  end

endmodule

`default_nettype wire
