// SPDX-License-Identifier: Apache-2.0
// SPI host that reads every frame when it is ready: a FRAME command, then all bytes of the answer except wait bytes.
// Interface: sck_o runs at half of clk_i and only while cs_no is low; byte_valid_o pulses with every byte from the token on, done_o with the end.
// Timing: mode 0; COPI changes at falling edges of sck_o, CIPO is sampled at rising edges. CS rises a clock after the last.
// Why the answer is not checked here: the reader of the bytes sees refusals as well as frames.
`default_nettype none

module spi_host (
  input  wire       clk_i,
  input  wire       rst_ni,
  input  wire       frame_ready_i,
  output wire       sck_o,
  output wire       cs_no,
  output wire       copi_o,
  input  wire       cipo_i,
  output wire [7:0] byte_o,
  output wire       byte_valid_o,
  output wire       done_o
);

  localparam [7:0] FRAME = 8'h0B;
  localparam [7:0] WAIT  = 8'h00;
  localparam [7:0] TOKEN = 8'h3C;

  localparam [2:0] COMMAND   = 3'd0;
  localparam [2:0] ANSWER    = 3'd1;
  localparam [2:0] LENGTH_HI = 3'd2;
  localparam [2:0] LENGTH_LO = 3'd3;
  localparam [2:0] DATA      = 3'd4;
  localparam [2:0] END       = 3'd5;

  reg        selected_q;
  reg        sck_q;
  reg  [7:0] command_q;
  reg  [7:0] in_q;
  reg  [2:0] bit_q;
  reg  [2:0] state_q;
  reg [15:0] left_q;
  reg        valid_q;
  reg        done_q;

  wire  [7:0] got;
  wire [15:0] left;
  assign got  = {in_q[6:0], cipo_i};
  assign left = {left_q[15:8], got};

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      selected_q <= 1'b0;
      sck_q      <= 1'b0;
      command_q  <= 8'd0;
      in_q       <= 8'd0;
      bit_q      <= 3'd0;
      state_q    <= COMMAND;
      left_q     <= 16'd0;
      valid_q    <= 1'b0;
      done_q     <= 1'b0;
    end else if (!selected_q) begin
      done_q     <= 1'b0;
      selected_q <= frame_ready_i;
      command_q  <= FRAME;
      state_q    <= COMMAND;
    end else if (sck_q) begin
      sck_q     <= 1'b0;
      command_q <= {command_q[6:0], 1'b0};
      valid_q   <= 1'b0;
    end else if (state_q == END) begin
      selected_q <= 1'b0;
      done_q     <= 1'b1;
    end else begin
      sck_q <= 1'b1;
      in_q  <= got;
      bit_q <= bit_q + 3'd1;
      if (bit_q == 3'd7) begin
        valid_q <= (state_q != COMMAND) && (state_q != ANSWER || got != WAIT);
        case (state_q)
          COMMAND:   state_q <= ANSWER;
          ANSWER:    state_q <= (got == WAIT) ? ANSWER : (got == TOKEN) ? LENGTH_HI : END;
          LENGTH_HI: state_q <= LENGTH_LO;
          LENGTH_LO: state_q <= (left == 16'd0) ? END : DATA;
          default:   state_q <= (left_q == 16'd1) ? END : DATA;
        endcase
        case (state_q)
          LENGTH_HI: left_q <= {got, 8'd0};
          LENGTH_LO: left_q <= left;
          default:   left_q <= left_q - 16'd1;
        endcase
      end
    end

  assign sck_o        = sck_q;
  assign cs_no        = ~selected_q;
  assign copi_o       = command_q[7];
  assign byte_o       = in_q;
  assign byte_valid_o = valid_q;
  assign done_o       = done_q;

endmodule

`default_nettype wire
