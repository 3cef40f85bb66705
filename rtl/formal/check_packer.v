// SPDX-License-Identifier: Apache-2.0
// Theorems of the packer: every byte of a frame is that of docs/rtl.md in its place, and their number is the length.
// Interface: rows come at any time when the packer is idle, with any slot, flags and counts; pedestals are free at every clock.
// Timing: one step is one clock. place_q counts the bytes of a row: 0..7 header, 8 slot, then codes, overflow bits, CRC.
// Why rows without a header start at place 8: the place then determines the kind of the byte in any row.
`default_nettype none

module check_packer #(
  parameter COLS      = 3,
  parameter CODE_BITS = 4
) (
  input wire                      clk_i,
  input wire                      rst_ni,
  input wire                      row_valid_i,
  input wire [7:0]                slot_i,
  input wire                      first_i,
  input wire                      last_i,
  input wire                      test_frame_i,
  input wire                      dark_frame_i,
  input wire [15:0]               gate_clocks_i,
  input wire [CODE_BITS:0]        count_i,
  input wire [1:0]                pedestal_mode_i,
  input wire [COLS*CODE_BITS-1:0] pedestal_i,
  input wire                      fault_i
);

  localparam B     = (CODE_BITS > 8) ? 2 : 1;
  localparam V     = (COLS + 7) / 8;
  localparam CODES = 9;
  localparam OVERS = CODES + COLS * B;
  localparam CRC   = OVERS + V;

  wire               shift;
  wire               busy;
  wire [15:0]        frame_number;
  wire               opens;
  wire               we;
  wire [7:0]         byte_out;
  wire               closes;
  wire               underflow;
  wire               column_valid;
  wire [6:0]         column;
  wire [CODE_BITS:0] column_count;
  wire [7:0]         column_slot;

  dermis_packer #(.COLS (COLS), .CODE_BITS (CODE_BITS)) u_dut (
    .clk_i           (clk_i),
    .rst_ni          (rst_ni),
    .row_valid_i     (row_valid_i),
    .slot_i          (slot_i),
    .first_i         (first_i),
    .last_i          (last_i),
    .test_frame_i    (test_frame_i),
    .dark_frame_i    (dark_frame_i),
    .gate_clocks_i   (gate_clocks_i),
    .count_i         (count_i),
    .count_shift_o   (shift),
    .busy_o          (busy),
    .pedestal_mode_i (pedestal_mode_i),
    .pedestal_i      (pedestal_i),
    .fault_i         (fault_i),
    .frame_number_o  (frame_number),
    .begin_o         (opens),
    .we_o            (we),
    .byte_o          (byte_out),
    .end_o           (closes),
    .underflow_o     (underflow),
    .column_valid_o  (column_valid),
    .column_o        (column),
    .column_count_o  (column_count),
    .column_slot_o   (column_slot)
  );

  // Internal signals, for the induction only.
  wire [2:0]                tap_phase;
  wire [6:0]                tap_index;
  wire                      tap_low;
  wire [15:0]               tap_crc;
  wire [8*V-1:0]            tap_over;
  wire [COLS*CODE_BITS-1:0] tap_ring;

  function [15:0] crc16;
    input [15:0] crc;
    input [7:0]  data;
    integer b;
    begin
      crc16 = crc;
      for (b = 7; b >= 0; b = b - 1) crc16 = {crc16[14:0], 1'b0} ^ ((crc16[15] ^ data[b]) ? 16'h1021 : 16'h0000);
    end
  endfunction

  // The offered row: stable until it is packed, assumed here and proved of the reader.
  reg        started_q = 1'b0;
  reg        working_q;
  reg [9:0]  place_q;
  reg [15:0] crc_q;
  reg [15:0] number_q;
  reg [15:0] bytes_q;
  reg [7:0]  rows_q;
  reg        closes_q;
  reg        open_q;
  reg [33:0] row_q;
  reg [COLS-1:0] over_q;
  reg        under_q;
  reg        underflow_q;
  wire [33:0] row = {slot_i, first_i, last_i, test_frame_i, dark_frame_i, gate_clocks_i, pedestal_mode_i, 4'd0};
  wire [1:0]  mode = (pedestal_mode_i == 3) ? 2'd0 : pedestal_mode_i;

  // Any one column, and the count of its last dark slot: the pedestal of mode 2.
  (* anyconst *) wire [6:0] one;
  reg [CODE_BITS-1:0] dark_q;

  wire        in_codes = working_q & (place_q >= CODES) & (place_q < OVERS);
  wire [9:0]  offset   = place_q - CODES;
  wire [6:0]  number   = (B == 2) ? offset[7:1] : offset[6:0];
  wire        low      = (B == 1) | offset[0];
  wire        special  = (slot_i[7:4] == 4'hF);
  wire [CODE_BITS-1:0] pedestal = special ? 0 : mode == 1 ? (pedestal_i >> (number * CODE_BITS)) : mode == 2 ? dark_q : 0;
  // Theorems of values are for one free column, so that one word of the ring is enough.
  wire [CODE_BITS+1:0] above = (count_i > pedestal) ? count_i - pedestal : 0;
  wire        over     = above > ((1 << CODE_BITS) - 1);
  wire [15:0] code     = over ? (1 << CODE_BITS) - 1 : above;
  wire [9:0]  ends     = last_i ? CRC + 1 : CRC - 1;
  reg  [7:0]  wanted;

  always @*
    if (place_q < 8)
      case (place_q[2:0])
        3'd0:    wanted = 8'h01;
        3'd1:    wanted = {3'd0, fault_i, dark_frame_i, mode, test_frame_i};
        3'd2:    wanted = number_q[15:8];
        3'd3:    wanted = number_q[7:0];
        3'd4:    wanted = COLS;
        3'd5:    wanted = CODE_BITS;
        3'd6:    wanted = gate_clocks_i[15:8];
        default: wanted = gate_clocks_i[7:0];
      endcase
    else if (place_q == 8)    wanted = slot_i;
    else if (place_q < OVERS) wanted = low ? code[7:0] : code[15:8];
    else if (place_q < CRC)   wanted = {{(8*V){1'b0}}, over_q} >> (8 * (place_q - OVERS));
    else                      wanted = (place_q == CRC) ? crc_q[15:8] : crc_q[7:0];

  always @(posedge clk_i) begin
    started_q <= 1'b1;
    row_q     <= row;
  end

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      working_q <= 1'b0;
      place_q   <= 10'd0;
      crc_q     <= 16'd0;
      number_q  <= 16'd0;
      bytes_q   <= 16'd0;
      rows_q    <= 8'd0;
      closes_q  <= 1'b0;
      open_q    <= 1'b0;
      over_q    <= {COLS{1'b0}};
      under_q   <= 1'b0;
      underflow_q <= 1'b0;
      dark_q    <= {CODE_BITS{1'b0}};
    end else begin
      closes_q <= working_q & (place_q == CRC + 1);
      if (we) bytes_q <= bytes_q + 16'd1;
      if (row_valid_i) begin
        working_q <= 1'b1;
        place_q   <= first_i ? 10'd0 : 10'd8;
        rows_q    <= first_i ? 8'd1 : rows_q + 8'd1;
        if (first_i) begin
          number_q <= number_q + 16'd1;
          crc_q    <= 16'hFFFF;
          bytes_q  <= 16'd0;
          under_q  <= 1'b0;
          open_q   <= 1'b1;
        end
      end else if (working_q) begin
        place_q   <= place_q + 10'd1;
        working_q <= (place_q != ends);
        if (place_q == CRC + 1) open_q <= 1'b0;
        if (place_q == CRC + 1) underflow_q <= under_q;
        // As for the overflow: of the one column from the reference, of the others from the design.
        if (in_codes && low && ((number == one) ? count_i < pedestal : tap_is_under)) under_q <= 1'b1;
        if (place_q < CRC) crc_q <= crc16(crc_q, byte_out);
        // The overflow of the design; its correctness for the one column is part of theorem each_byte.
        if (in_codes && low && number == one) over_q[one] <= over;
        if (in_codes && low && number != one) over_q[number] <= tap_is_over;
        if (in_codes && low && number == one && slot_i == 8'hF1) dark_q <= code[CODE_BITS-1:0];
      end
    end
  wire tap_is_over;
  wire tap_is_under;
  wire tap_under;

  // Places of the one column in the rotating words of the design.
  wire [6:0] done = in_codes ? number : 7'd0;
  wire [6:0] at   = (one >= done) ? one - done : one + COLS - done;
  wire [COLS*CODE_BITS-1:0] rotated = tap_ring >> (at * CODE_BITS);
  wire [8*V-1:0] overs = (place_q >= OVERS) ? {{(8*V){1'b0}}, over_q} >> (8 * (place_q - OVERS)) : {(8*V){1'b0}};

  always @* begin
    if (!started_q) assume (!rst_ni);
    assume (one < COLS);
    // The reader's part: a row only when the last one is packed, the same until it is, and a frame begun before it goes on.
    if (working_q) assume (!row_valid_i && row == row_q);
    if (row_valid_i && !first_i) assume (open_q);
    if (open_q && !working_q) assume (rows_q < 132);

    writes: assert (we == working_q && busy == working_q);
    if (working_q && (place_q < CODES || place_q >= OVERS || number == one)) each_byte: assert (byte_out == wanted);
    if (rst_ni) frame_opens: assert (opens == (row_valid_i && first_i));
    frame_closes: assert (closes == closes_q);
    if (closes) length: assert (bytes_q == 10 + rows_q * (1 + COLS * B + V));
    takes_each_column_once: assert (shift == (in_codes && low) && column_valid == shift && (!shift || column == number)
      && column_count == count_i && column_slot == slot_i);
    tells_an_underflow: assert (underflow == underflow_q);
    numbers: assert (frame_number == number_q);

    lemma_phase: assert (tap_phase == (!working_q ? 0 : place_q < 8 ? 1 : place_q == 8 ? 2 : place_q < OVERS ? 3 : place_q < CRC ? 4 : 5));
    lemma_place: assert (!working_q || (place_q <= ends && (first_i || place_q >= 8)));
    lemma_index: assert (!working_q || place_q == 8 || tap_index == (place_q < 8 ? place_q : place_q < OVERS ? number
      : place_q < CRC ? place_q - OVERS : place_q - CRC));
    lemma_low: assert (!in_codes || tap_low == (B == 2 && offset[0]));
    lemma_under: assert (!open_q || tap_under == under_q);
    lemma_crc: assert (!open_q || tap_crc == crc_q);
    lemma_open: assert (!working_q || open_q);
    lemma_over: assert (in_codes ? (tap_over >> (COLS - number)) == (over_q & ((1 << number) - 1))
      : place_q >= OVERS && working_q ? tap_over == overs : (place_q < CODES && working_q || !working_q ? tap_over == 0 : 1'b1));
    lemma_ring: assert (rotated[CODE_BITS-1:0] == dark_q);
    lemma_bytes: assert (!open_q || bytes_q == (working_q ? (rows_q - 1) * (1 + COLS * B + V) + place_q : 8 + rows_q * (1 + COLS * B + V)));
    lemma_rows: assert (!open_q || (rows_q >= 1 && rows_q <= 133 && (!working_q || first_i == (rows_q == 1))));
    lemma_closes: assert (!closes_q || (!working_q && !open_q && bytes_q == 10 + rows_q * (1 + COLS * B + V)));

    two_rows: cover (rst_ni && closes_q && rows_q == 2);
    corrected: cover (rst_ni && in_codes && mode == 2 && !special && dark_q == 3 && code == 5 && number == one);
    overflows: cover (rst_ni && working_q && place_q == OVERS && over_q != 0 && over_q != {COLS{1'b1}});
  end

endmodule

`default_nettype wire
