// SPDX-License-Identifier: Apache-2.0
// Technology cell in a library without memories: replaces rtl/dermis_tech_ram.v in synthesis. A
// latch per bit and a gate per byte, in place of a flop and a multiplexer per bit.
// Interface: the same; a byte written at an edge is there from the falling edge after it.
// Timing: address and byte are sampled at the edge; a byte's latches are open while the clock is
// low in the period that follows, so that what opens and what enters them has half a period.
// Why the low half: select and data come from flops of the rising edge and move while the clock is
// high, when every gate is shut. At the next rising edge the gate shuts before the data move, by a
// flop and the buffers to all bytes: the hold paths of `dermis synth`.
`default_nettype none

module dermis_tech_ram #(
  parameter WORDS = 2
) (
  input  wire        clk_i,
  input  wire        we_i,
  input  wire [15:0] waddr_i,
  input  wire [7:0]  wdata_i,
  input  wire        rclk_i,
  input  wire [15:0] raddr_i,
  output wire [7:0]  rdata_o
);

  localparam         ADDRESS_BITS = (WORDS > 1) ? $clog2(WORDS) : 1;
  localparam         LEAVES       = 1 << ADDRESS_BITS;
  localparam integer SIZE         = WORDS;
  localparam         GROUP_BITS   = 4;
  localparam         GROUPS       = (WORDS + (1 << GROUP_BITS) - 1) >> GROUP_BITS;

  reg                    we_q;
  reg [ADDRESS_BITS-1:0] waddr_q;
  reg [7:0]              wdata_q;

  always @(posedge clk_i) begin
    we_q <= we_i & ({1'b0, waddr_i} < SIZE[16:0]);
    if (we_i) begin
      waddr_q <= waddr_i[ADDRESS_BITS-1:0];
      wdata_q <= wdata_i;
    end
  end

  // A tree of multiplexers: node 1 is the root, the sons of node n are 2n and 2n + 1.
  wire [16*LEAVES-1:0] node;

  // The byte goes to the latches of one group only: the data of the others rest.
  wire [8*GROUPS-1:0] wdata;

  genvar n;
  genvar b;
  genvar d;
  generate
    assign node[7:0] = 8'h00;
    for (n = 0; n < GROUPS; n = n + 1) begin : gen_group
      localparam [ADDRESS_BITS-1:0] NUMBER = n;

      assign wdata[8*n +: 8] = wdata_q & {8{we_q & (waddr_q >> GROUP_BITS == NUMBER)}};
    end
    for (n = 0; n < LEAVES; n = n + 1) begin : gen_leaf
      if (n < WORDS) begin : gen_word
        localparam [ADDRESS_BITS-1:0] NUMBER = n;
        wire                          shut;

        assign shut = ~(we_q & (waddr_q == NUMBER)) | clk_i;
        for (b = 0; b < 8; b = b + 1) begin : gen_bit
          dermis_tech_latch u_latch (
            .gate_ni (shut),
            .rst_ni  (1'b1),
            .d_i     (wdata[8*(n>>GROUP_BITS)+b]),
            .q_o     (node[8*(LEAVES+n)+b])
          );
        end
      end else begin : gen_none
        assign node[8*(LEAVES+n) +: 8] = 8'h00;
      end
    end
    for (d = 0; d < ADDRESS_BITS; d = d + 1) begin : gen_level
      for (n = 0; n < (1 << d); n = n + 1) begin : gen_node
        assign node[8*((1<<d)+n) +: 8] = raddr_i[ADDRESS_BITS-1-d] ? node[8*(2*((1<<d)+n)+1) +: 8]
                                                                    : node[8*2*((1<<d)+n) +: 8];
      end
    end
  endgenerate

  // The read needs no clock: rtl/dermis_tech_ram.v.
  wire unused_rclk;
  assign unused_rclk = rclk_i;

  assign rdata_o = ({1'b0, raddr_i} < SIZE[16:0]) ? node[15:8] : 8'h00;

endmodule

`default_nettype wire
