// SPDX-License-Identifier: Apache-2.0
// SPI peripheral, mode 0, in the domain of sck_i: register writes and reads, frame bursts.
// Interface: docs/spi.md. A request is a toggle; address_o and wdata_o are stable until
// ack_toggle_i equals it. hold_toggle_o requests a frame bank in the same way, which is then read
// at frame_address_o.
// Timing: COPI is sampled at rising edges, CIPO changes at falling edges. A byte takes effect at
// its eighth rising edge.
// Why toggles: they cross to clk_i at any ratio of the clocks, and while sck_i is stopped.
`default_nettype none

module dermis_spi (
  input  wire        rst_ni,
  input  wire        sck_i,
  input  wire        cs_ni,
  input  wire        copi_i,
  output wire        cipo_o,
  output wire        cipo_oe_o,
  output wire        request_toggle_o,
  output wire        write_o,
  output wire [7:0]  address_o,
  output wire [15:0] wdata_o,
  input  wire        ack_toggle_i,
  input  wire [15:0] rdata_i,
  input  wire        refused_i,
  output wire        hold_toggle_o,
  input  wire        hold_ack_i,
  output wire [15:0] frame_address_o,
  input  wire [7:0]  frame_data_i,
  input  wire [15:0] frame_length_i,
  output wire        error_toggle_o
);

  localparam [7:0] OP_WRITE     = 8'h02;
  localparam [7:0] OP_READ      = 8'h03;
  localparam [7:0] OP_FRAME     = 8'h0B;
  localparam [7:0] TOKEN_DONE   = 8'h5A;
  localparam [7:0] TOKEN_DATA   = 8'hA5;
  localparam [7:0] TOKEN_FRAME  = 8'h3C;
  localparam [7:0] TOKEN_OPCODE = 8'hE0;
  localparam [7:0] TOKEN_CRC    = 8'hE1;
  localparam [7:0] TOKEN_BUSY   = 8'hE2;
  localparam [7:0] TOKEN_ACCESS = 8'hE3;

  localparam [3:0] OPCODE        = 4'd0;
  localparam [3:0] READ_ADDRESS  = 4'd1;
  localparam [3:0] DATA_HIGH     = 4'd2;
  localparam [3:0] DATA_LOW      = 4'd3;
  localparam [3:0] CHECK         = 4'd4;
  localparam [3:0] REQUESTED     = 4'd5;
  localparam [3:0] ANSWER_HIGH   = 4'd6;
  localparam [3:0] ANSWER_LOW    = 4'd7;
  localparam [3:0] ANSWER_CRC    = 4'd8;
  localparam [3:0] FRAME_CLAIM   = 4'd9;
  localparam [3:0] FRAME_CLAIMED = 4'd10;
  localparam [3:0] LENGTH_HIGH   = 4'd11;
  localparam [3:0] LENGTH_LOW    = 4'd12;
  localparam [3:0] FRAME_BYTES   = 4'd13;
  localparam [3:0] FINISHED      = 4'd14;
  localparam [3:0] WRITE_ADDRESS = 4'd15;

  // Begun after the latest reset: the rest of a transaction interrupted by reset is no command.
  reg begun_q;

  always @(negedge cs_ni or negedge rst_ni)
    if (!rst_ni) begun_q <= 1'b0;
    else         begun_q <= 1'b1;

  wire ack;
  wire hold_ack;

  dermis_tech_sync u_sync_ack (
    .clk_i  (sck_i),
    .rst_ni (rst_ni),
    .d_i    (ack_toggle_i),
    .q_o    (ack)
  );

  dermis_tech_sync u_sync_hold_ack (
    .clk_i  (sck_i),
    .rst_ni (rst_ni),
    .d_i    (hold_ack_i),
    .q_o    (hold_ack)
  );

  // State of one transaction: CS high is its reset.
  wire        rst_spi_n;
  reg  [2:0]  bit_q;
  reg  [6:0]  in_q;
  reg  [7:0]  out_q;
  reg  [7:0]  crc_q;
  reg  [3:0]  state_q;
  reg         busy_q;
  reg  [15:0] frame_address_q;

  // State across transactions.
  reg         request_q;
  reg         write_q;
  reg  [7:0]  address_q;
  reg  [15:0] wdata_q;
  reg         hold_q;
  reg         error_q;

  wire        last_bit;
  wire [7:0]  byte_in;
  wire        request_idle;
  wire        hold_idle;
  wire        answering;
  wire        is_address;
  wire [7:0]  crc_byte;
  wire [7:0]  crc_next;
  wire        crc_good;

  reg  [3:0]  state_d;
  reg  [7:0]  byte_out;
  reg         request;
  reg         claim;
  reg         refuse;

  assign rst_spi_n    = ~cs_ni & rst_ni;
  assign last_bit     = &bit_q;
  assign byte_in      = {in_q, copi_i};
  assign request_idle = (ack == request_q);
  assign hold_idle    = (hold_ack == hold_q);

  // Bytes of the command in, then, for a read, bytes of the answer out.
  assign answering    = (state_q == ANSWER_HIGH) | (state_q == ANSWER_LOW);
  assign is_address   = (state_q == READ_ADDRESS) | (state_q == WRITE_ADDRESS);
  assign crc_byte     = answering ? byte_out : byte_in;
  assign crc_good     = (byte_in == crc_q);

  dermis_crc8 u_crc (
    .crc_i  (crc_q),
    .data_i (crc_byte),
    .crc_o  (crc_next)
  );

  always @* begin
    state_d  = state_q;
    byte_out = 8'h00;
    request  = 1'b0;
    claim    = 1'b0;
    refuse   = 1'b0;
    case (state_q)
      OPCODE:
        if (!begun_q)                 state_d = FINISHED;
        else if (byte_in == OP_WRITE) state_d = WRITE_ADDRESS;
        else if (byte_in == OP_READ)  state_d = READ_ADDRESS;
        else if (byte_in == OP_FRAME) begin
          state_d = hold_idle ? FRAME_CLAIMED : FRAME_CLAIM;
          claim   = hold_idle;
        end else begin
          state_d  = FINISHED;
          byte_out = TOKEN_OPCODE;
          refuse   = 1'b1;
        end
      WRITE_ADDRESS: state_d = DATA_HIGH;
      READ_ADDRESS:
        if (busy_q) begin
          state_d  = FINISHED;
          byte_out = TOKEN_BUSY;
          refuse   = 1'b1;
        end else begin
          state_d = REQUESTED;
          request = 1'b1;
        end
      DATA_HIGH:     state_d = DATA_LOW;
      DATA_LOW:      state_d = CHECK;
      CHECK:
        if (!crc_good || busy_q) begin
          state_d  = FINISHED;
          byte_out = crc_good ? TOKEN_BUSY : TOKEN_CRC;
          refuse   = 1'b1;
        end else begin
          state_d = REQUESTED;
          request = 1'b1;
        end
      REQUESTED:
        if (request_idle) begin
          if (refused_i) begin
            state_d  = FINISHED;
            byte_out = TOKEN_ACCESS;
            refuse   = 1'b1;
          end else begin
            state_d  = write_q ? FINISHED : ANSWER_HIGH;
            byte_out = write_q ? TOKEN_DONE : TOKEN_DATA;
          end
        end
      ANSWER_HIGH: begin
        state_d  = ANSWER_LOW;
        byte_out = rdata_i[15:8];
      end
      ANSWER_LOW: begin
        state_d  = ANSWER_CRC;
        byte_out = rdata_i[7:0];
      end
      ANSWER_CRC: begin
        state_d  = FINISHED;
        byte_out = crc_q;
      end
      // The claim of an aborted transaction may still be crossing. Its grant ends with the CS of
      // that transaction and must not be used: only the claim of this transaction holds the bank.
      FRAME_CLAIM:
        if (hold_idle) begin
          state_d = FRAME_CLAIMED;
          claim   = 1'b1;
        end
      FRAME_CLAIMED:
        if (hold_idle) begin
          state_d  = LENGTH_HIGH;
          byte_out = TOKEN_FRAME;
        end
      LENGTH_HIGH: begin
        state_d  = LENGTH_LOW;
        byte_out = frame_length_i[15:8];
      end
      LENGTH_LOW: begin
        state_d  = FRAME_BYTES;
        byte_out = frame_length_i[7:0];
      end
      FRAME_BYTES:
        if (frame_address_q == frame_length_i) state_d  = FINISHED;
        else                                   byte_out = frame_data_i;
      default: state_d = FINISHED;
    endcase
  end

  always @(posedge sck_i or negedge rst_spi_n)
    if (!rst_spi_n) begin
      bit_q           <= 3'd0;
      in_q            <= 7'd0;
      out_q           <= 8'd0;
      crc_q           <= 8'd0;
      state_q         <= OPCODE;
      busy_q          <= 1'b0;
      frame_address_q <= 16'd0;
    end else begin
      bit_q <= bit_q + 3'd1;
      in_q  <= byte_in[6:0];
      out_q <= {out_q[6:0], 1'b0};
      if (last_bit) begin
        out_q   <= byte_out;
        state_q <= state_d;
        if (state_q != REQUESTED) crc_q <= crc_next;
        if (state_q == OPCODE) busy_q <= ~request_idle;
        if (state_q == FRAME_BYTES && state_d == FRAME_BYTES) frame_address_q <= frame_address_q + 16'd1;
      end
    end

  // Crossing data must be stable: while an earlier request is pending (busy) the payload is kept.
  always @(posedge sck_i or negedge rst_ni)
    if (!rst_ni) begin
      request_q <= 1'b0;
      write_q   <= 1'b0;
      address_q <= 8'd0;
      wdata_q   <= 16'd0;
      hold_q    <= 1'b0;
      error_q   <= 1'b0;
    end else if (last_bit) begin
      if (request) request_q <= ~request_q;
      if (claim)   hold_q    <= ~hold_q;
      if (refuse)  error_q   <= ~error_q;
      if (state_q == OPCODE && request_idle) write_q <= (byte_in == OP_WRITE);
      if (is_address && !busy_q)           address_q <= byte_in;
      if (state_q == DATA_HIGH && !busy_q) wdata_q   <= {byte_in, wdata_q[7:0]};
      if (state_q == DATA_LOW && !busy_q)  wdata_q   <= {wdata_q[15:8], byte_in};
    end

  reg cipo_q;

  always @(negedge sck_i or negedge rst_spi_n)
    if (!rst_spi_n) cipo_q <= 1'b0;
    else           cipo_q <= out_q[7];

  assign cipo_o           = cipo_q;
  assign cipo_oe_o        = ~cs_ni;
  assign request_toggle_o = request_q;
  assign write_o          = write_q;
  assign address_o        = address_q;
  assign wdata_o          = wdata_q;
  assign hold_toggle_o    = hold_q;
  assign frame_address_o  = frame_address_q;
  assign error_toggle_o   = error_q;

endmodule

`default_nettype wire
