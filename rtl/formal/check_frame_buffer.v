// SPDX-License-Identifier: Apache-2.0
// Theorems of the frame buffer: a held frame is one whole frame, byte by byte, and stable until its release.
// Interface: frames, the hold request and CS are free at every clock, and so are the samples of their synchronizers.
// Timing: one step is one clock.
// Why the read address is any constant: the read is combinational, no state depends on it, and a theorem of one free
// address holds for all. The memory is an array of the solver, so the size of a bank does not matter.
`default_nettype none

module check_frame_buffer #(
  parameter BANK_BYTES = 390
) (
  input wire       clk_i,
  input wire       rst_ni,
  input wire       begin_i,
  input wire       we_i,
  input wire [7:0] byte_i,
  input wire       end_i,
  input wire       cs_ni,
  input wire       hold_toggle_i
);

  (* anyconst *) wire [15:0] address;

  wire        ready;
  wire [15:0] lost;
  wire        ack;
  wire [7:0]  rdata;
  wire [15:0] length;

  dermis_frame_buffer #(.BANK_BYTES (BANK_BYTES)) u_dut (
    .clk_i         (clk_i),
    .rst_ni        (rst_ni),
    .begin_i       (begin_i),
    .we_i          (we_i),
    .byte_i        (byte_i),
    .end_i         (end_i),
    .frame_ready_o (ready),
    .lost_o        (lost),
    .cs_ni         (cs_ni),
    .hold_toggle_i (hold_toggle_i),
    .hold_ack_o    (ack),
    .raddr_i       (address),
    .rdata_o       (rdata),
    .length_o      (length)
  );

  // Internal signals, for the induction only.
  wire        tap_front;
  wire        tap_held;
  wire        tap_waiting;
  wire        tap_deselected;
  wire        tap_hold;
  wire [15:0] tap_waddr;
  wire [15:0] tap_length0;
  wire [15:0] tap_length1;
  wire [7:0]  tap_rdata0;
  wire [7:0]  tap_rdata1;
  wire        tap_we0;
  wire        tap_we1;

  reg started_q = 1'b0;
  always @(posedge clk_i) started_q <= 1'b1;

  // Reference: length and byte at the address of three frames: one written, one waiting, one readable.
  reg         open_q;
  reg  [15:0] written_q;
  reg  [7:0]  written_byte_q;
  reg         waiting_q;
  reg  [15:0] waiting_length_q;
  reg  [7:0]  waiting_byte_q;
  reg  [15:0] shown_length_q;
  reg  [7:0]  shown_byte_q;
  reg         held_q;
  reg         ack_q;
  reg  [15:0] lost_q;
  reg         new_q;
  reg  [1:0]  deselected_q;
  reg  [1:0]  hold_q;

  wire        grant = hold_q[1] ^ ack_q;
  wire        free  = ~held_q | grant | deselected_q[1];
  wire [15:0] place = begin_i ? 16'd0 : written_q;
  wire [15:0] count = place + {15'd0, we_i};
  wire [7:0]  value = (we_i && place == address) ? byte_i : written_byte_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      open_q           <= 1'b0;
      written_q        <= 16'd0;
      written_byte_q   <= 8'd0;
      waiting_q        <= 1'b0;
      waiting_length_q <= 16'd0;
      waiting_byte_q   <= 8'd0;
      shown_length_q   <= 16'd0;
      shown_byte_q     <= 8'd0;
      held_q           <= 1'b0;
      ack_q            <= 1'b0;
      lost_q           <= 16'd0;
      new_q            <= 1'b0;
      deselected_q     <= 2'b00;
      hold_q           <= 2'b00;
    end else begin
      deselected_q   <= {deselected_q[0], cs_ni};
      hold_q         <= {hold_q[0], hold_toggle_i};
      ack_q          <= hold_q[1];
      open_q         <= (open_q | begin_i) & ~end_i;
      written_q      <= count;
      written_byte_q <= value;
      held_q         <= grant | (held_q & ~deselected_q[1]);
      if (free && waiting_q) begin
        shown_length_q <= waiting_length_q;
        shown_byte_q   <= waiting_byte_q;
        waiting_q      <= 1'b0;
      end
      if (!free && waiting_q && begin_i) begin
        waiting_q <= 1'b0;
        if (!(&lost_q)) lost_q <= lost_q + 16'd1;
      end
      // One that is ready is replaced before anybody held it.
      if (free && (end_i || waiting_q) && new_q && !(&lost_q)) lost_q <= lost_q + 16'd1;
      if (end_i && free && !waiting_q) begin
        shown_length_q <= count;
        shown_byte_q   <= value;
      end
      if (end_i && !free || end_i && waiting_q) begin
        waiting_q        <= 1'b1;
        waiting_length_q <= count;
        waiting_byte_q   <= value;
      end
      if (grant)                              new_q <= 1'b0;
      else if (free && (end_i || waiting_q)) new_q <= 1'b1;
    end

  // Values one clock ago, for the theorem without reference.
  reg         resting_q;
  reg  [15:0] length_q;
  reg  [7:0]  rdata_q;
  reg         front_q;
  always @(posedge clk_i) begin
    resting_q <= rst_ni & held_q & ~grant & ~deselected_q[1];
    length_q  <= length;
    rdata_q   <= rdata;
    front_q   <= tap_front;
  end

  always @* begin
    if (!started_q) assume (!rst_ni);
    // The packer's part: bytes and an end only inside a frame, no frame longer than a bank (theorem packer.fits), and no
    // frame that begins and ends in a clock without the one before being looked at: it is never shorter than its header.
    if (!open_q && !begin_i) assume (!we_i && !end_i);
    assume (count <= BANK_BYTES);
    assume (!(begin_i && end_i));

    if (started_q && resting_q && rst_ni) begin
      held_rests: assert (length == length_q && front_q == tap_front && (address >= length || rdata == rdata_q));
    end
    if (rst_ni && held_q) no_write_to_the_held_bank: assert (!(tap_front ? tap_we1 : tap_we0) || (grant | deselected_q[1]));
    whole_frame: assert (length == shown_length_q && (address >= length || rdata == shown_byte_q));
    inside_the_bank: assert (length <= BANK_BYTES);
    acknowledges: assert (ack == ack_q);
    counts_lost: assert (lost == lost_q);
    tells_a_new_frame: assert (ready == new_q);

    // For the induction: the state of the design matches the reference.
    lemma_control: assert (tap_held == held_q && tap_waiting == waiting_q && tap_waddr == written_q
      && tap_deselected == deselected_q[1] && tap_hold == hold_q[1]);
    lemma_wait: assert (!(waiting_q && open_q) && (!waiting_q || held_q));
    lemma_shown: assert (shown_length_q == (tap_front ? tap_length1 : tap_length0));
    lemma_waiting: assert (!waiting_q || (waiting_length_q <= BANK_BYTES
      && waiting_length_q == (tap_front ? tap_length0 : tap_length1)
      && (address >= waiting_length_q || waiting_byte_q == (tap_front ? tap_rdata0 : tap_rdata1))));
    lemma_written: assert (!open_q || (written_q <= BANK_BYTES
      && (address >= written_q || written_byte_q == (tap_front ? tap_rdata0 : tap_rdata1))));

    held_while_another_ends: cover (rst_ni && resting_q && waiting_q && length == 2 && written_q == 1);
    loses_one: cover (rst_ni && lost == 1 && held_q);
    shows_the_one_that_waited: cover (rst_ni && started_q && held_q && lost == 0 && length == 1 && length_q == 2);
  end

endmodule

`default_nettype wire
