// SPDX-License-Identifier: Apache-2.0
// Theorems of the SPI peripheral: only a complete command gives a request, with a payload that is then stable.
// Interface: SCK, CS, COPI, reset and the time of each acknowledge are free at every step of a global clock.
// Timing: a step is any part of a period of SCK; CS and reset are stable in the step of a rising SCK (setup and hold).
// Why a CRC bit by bit and a count of bits: the reference has no bytes, states or tables of the design.
`default_nettype none

module check_spi #(
  // For searches only: SCK changes at every step, no further reset.
  parameter SEARCH = 0
) (
  input wire rst_ni,
  input wire sck_i,
  input wire cs_ni,
  input wire copi_i,
  input wire answer_i,
  input wire [15:0] rdata_i,
  input wire refused_i,
  input wire hold_answer_i,
  input wire [7:0] frame_data_i,
  input wire [15:0] frame_length_i
);

  (* gclk *) reg global;

  wire        cipo;
  wire        cipo_oe;
  wire        request;
  wire        write;
  wire [7:0]  address;
  wire [15:0] wdata;
  wire        hold;
  wire [15:0] frame_address;
  wire        error;

  reg         answered_q;
  reg         granted_q;
  reg  [15:0] rdata_q;
  reg         refused_q;
  // Masked, because a flop of the global clock has no asynchronous reset.
  wire        ack_q      = answered_q & rst_ni;
  wire        hold_ack_q = granted_q & rst_ni;

  dermis_spi u_dut (
    .rst_ni           (rst_ni),
    .sck_i            (sck_i),
    .cs_ni            (cs_ni),
    .copi_i           (copi_i),
    .cipo_o           (cipo),
    .cipo_oe_o        (cipo_oe),
    .request_toggle_o (request),
    .write_o          (write),
    .address_o        (address),
    .wdata_o          (wdata),
    .ack_toggle_i     (ack_q),
    .rdata_i          (rdata_q),
    .refused_i        (refused_q),
    .hold_toggle_o    (hold),
    .hold_ack_i       (hold_ack_q),
    .frame_address_o  (frame_address),
    .frame_data_i     (frame_data_i),
    .frame_length_i   (frame_length_i),
    .error_toggle_o   (error)
  );

  // Internal signals, for the proof only.
  wire [2:0]  tap_bit;
  wire [6:0]  tap_in;
  wire [7:0]  tap_crc;
  wire [3:0]  tap_state;
  wire        tap_busy;
  wire        tap_begun;
  wire [7:0]  tap_out;
  wire        tap_ack1;
  wire        tap_ack2;

  // Bus side: answers requests at any time; answers are stable with the acknowledge.
  always @(posedge global)
    if (!rst_ni) begin
      answered_q <= 1'b0;
      granted_q  <= 1'b0;
    end else begin
      if (answer_i && ack_q != request) begin
        answered_q <= request;
        rdata_q   <= rdata_i;
        refused_q <= refused_i;
      end
      if (hold_answer_i) granted_q <= hold;
    end

  reg started_q = 1'b0;
  reg rst_nq;
  reg sck_q;
  reg cs_nq;
  reg request_q;
  reg hold_q;
  reg error_q;
  reg pending_q;
  reg [24:0] payload_q;
  always @(posedge global) begin
    started_q <= 1'b1;
    rst_nq    <= rst_ni;
    sck_q     <= sck_i;
    cs_nq     <= cs_ni;
    request_q <= request;
    hold_q    <= hold;
    error_q   <= error;
    pending_q <= (request != ack_q);
    payload_q <= {write, address, wdata};
  end
  wire rises = sck_i & ~sck_q;
  wire alive = started_q & rst_ni & rst_nq;

  // Bit by bit from the polynomial.
  function [7:0] crc8;
    input [7:0] crc;
    input [7:0] data;
    integer b;
    begin
      crc8 = crc;
      for (b = 7; b >= 0; b = b - 1) crc8 = {crc8[6:0], 1'b0} ^ ((crc8[7] ^ data[b]) ? 8'h07 : 8'h00);
    end
  endfunction

  function [7:0] sent_byte;
    input [39:0] sent;
    input [5:0]  ago;
    reg   [39:0] shifted;
    begin
      shifted   = sent >> ago;
      sent_byte = shifted[7:0];
    end
  endfunction

  // Bits since CS fell: their number (modulo 8 from 48 on), the bits, the CRC of the first 32.
  wire        selected = ~cs_ni & rst_ni;
  reg  [5:0]  bits_q;
  reg  [39:0] sent_q;
  reg  [7:0]  crc_q;
  always @(posedge sck_i or negedge selected)
    if (!selected) begin
      bits_q <= 6'd0;
      sent_q <= 40'd0;
      crc_q  <= 8'd0;
    end else begin
      bits_q <= (bits_q == 6'd55) ? 6'd48 : bits_q + 6'd1;
      if (bits_q < 40) sent_q <= {sent_q[38:0], copi_i};
      if (bits_q < 32 && bits_q[2:0] == 3'd7) crc_q <= crc8(crc_q, {sent_q[6:0], copi_i});
    end

  // A transaction that began after the latest reset.
  reg begun_q;
  always @(negedge cs_ni or negedge rst_ni)
    if (!rst_ni) begun_q <= 1'b0;
    else         begun_q <= 1'b1;

  // True if an earlier request was pending at the opcode; and the opcode.
  reg [7:0] opcode_q;
  always @(posedge sck_i or negedge selected)
    if (!selected) opcode_q <= 8'd0;
    else if (bits_q == 6'd7) opcode_q <= {sent_q[6:0], copi_i};

  wire good_write = (bits_q == 6'd40) & (sent_q[39:32] == 8'h02) & (sent_q[7:0] == crc_q)
    & write & (address == sent_q[31:24]) & (wdata == sent_q[23:8]);
  wire good_read  = (bits_q == 6'd16) & (sent_q[15:8] == 8'h03) & ~write & (address == sent_q[7:0]);

  always @(posedge global) begin
    if (!started_q) assume (!rst_ni && cs_ni && !sck_i);
    if (SEARCH != 0 && started_q) assume (sck_i == (!sck_q && rst_nq) && rst_ni);
    if (started_q && rises) assume (cs_ni == cs_nq && rst_ni == rst_nq);

    if (alive && request != request_q) complete_command_only: assert ((good_write || good_read) && begun_q && !cs_ni && !pending_q);
    if (alive && pending_q) payload_rests: assert ({write, address, wdata} == payload_q && request == request_q);
    if (alive && hold != hold_q) claims_for_a_frame_only: assert (opcode_q == 8'h0B && bits_q[2:0] == 3'd0 && begun_q && !cs_ni);
    if (alive && error != error_q) counts_at_byte_ends: assert (bits_q[2:0] == 3'd0 && bits_q >= 8 && begun_q && !cs_ni);
    if (started_q && rises && !cs_ni && bits_q <= 8) quiet_in_the_opcode: assert (!cipo);
    if (started_q && rises && !cs_ni && opcode_q == 8'h02 && bits_q <= 40) quiet_in_a_write: assert (!cipo);
    if (started_q && rises && !cs_ni && opcode_q == 8'h03 && bits_q <= 16) quiet_in_a_read: assert (!cipo);
    // No correct command is left out: not busy, complete, correct: the request is sent with its last bit.
    if (alive && rises && !cs_ni && begun_q && bits_q == 6'd40 && opcode_q == 8'h02 && sent_q[7:0] == crc_q && !tap_busy)
      good_write_goes_out: assert (request != request_q);
    if (alive && rises && !cs_ni && begun_q && bits_q == 6'd16 && opcode_q == 8'h03 && !tap_busy)
      good_read_goes_out: assert (request != request_q);
    if (started_q && (cs_ni || !rst_ni)) silent_when_not_selected: assert (!cipo && bits_q == 0 && cipo_oe == !cs_ni);

    // State from the bits sent: there is no other path through the states.
    if (started_q) begin
      states: assert (
        bits_q < 8   ? tap_state == 0 :
        !begun_q     ? tap_state == 14 :
        opcode_q == 8'h02 ? (bits_q < 16 ? tap_state == 15 : bits_q < 24 ? tap_state == 2 : bits_q < 32 ? tap_state == 3
                           : bits_q < 40 ? tap_state == 4 : (tap_state == 5 || tap_state == 14)) :
        opcode_q == 8'h03 ? (bits_q < 16 ? tap_state == 1 : (tap_state >= 5 && tap_state <= 8 || tap_state == 14)) :
        opcode_q == 8'h0B ? (tap_state >= 9 && tap_state <= 14) : tap_state == 14);
      lemma_bits: assert (tap_bit == bits_q[2:0] && bits_q < 56);
      lemma_in: assert (bits_q >= 40 || bits_q == 0 || (tap_in & ((7'd1 << bits_q[2:0]) - 7'd1)) == (sent_q[6:0] & ((7'd1 << bits_q[2:0]) - 7'd1)));
      lemma_opcode: assert (bits_q < 8 || bits_q > 40 || opcode_q == sent_byte(sent_q, bits_q - 6'd8));
      lemma_quiet: assert ((begun_q && tap_state > 4 && tap_state != 15) || (tap_out == 0 && !cipo));
      lemma_kind: assert (tap_state != 5 || write == (opcode_q == 8'h02));
      lemma_begun: assert (tap_begun == begun_q);
      lemma_not_busy: assert (tap_busy || tap_state == 0 || (tap_state > 4 && tap_state != 15) || request == ack_q);
      lemma_seen: assert (tap_busy || tap_state == 0 || (tap_state > 4 && tap_state != 15) || tap_ack2 == request);
      lemma_order: assert (tap_ack2 != ack_q || tap_ack1 == ack_q);
      lemma_sync: assert (request == ack_q || (tap_ack1 == ack_q && tap_ack2 == ack_q));
      lemma_crc: assert (bits_q >= 40 || (bits_q >= 8 && opcode_q != 8'h02) && bits_q >= 16 || tap_crc == crc_q);
      lemma_address: assert (!begun_q || bits_q < 16 || bits_q >= 40 || opcode_q != 8'h02 || tap_busy || address == sent_byte(sent_q, bits_q - 6'd16));
      lemma_wdata_high: assert (!begun_q || bits_q < 24 || bits_q >= 40 || opcode_q != 8'h02 || tap_busy || wdata[15:8] == sent_byte(sent_q, bits_q - 6'd24));
      lemma_wdata_low: assert (!begun_q || bits_q < 32 || bits_q >= 40 || opcode_q != 8'h02 || tap_busy || wdata[7:0] == sent_byte(sent_q, bits_q - 6'd32));
      lemma_write: assert (bits_q < 8 || bits_q >= 40 || tap_busy || !begun_q || write == (opcode_q == 8'h02) || bits_q >= 16 && opcode_q != 8'h02);
    end

    never_writes: assert (!(alive && request != request_q && write && address == 8'h04 && wdata == 16'hA55A));
    never_is_busy: assert (!(alive && error != error_q && opcode_q == 8'h03 && tap_busy));
    never_reads_a_frame: assert (!(alive && tap_state == 4'd13 && frame_address == 16'd1));
  end

endmodule

`default_nettype wire
