// SPDX-License-Identifier: Apache-2.0
// Double-buffered frame memory: one bank is written while the newest whole frame is read from the
// other.
// Interface: a frame is begin_i, bytes with we_i, and end_i; begin_i and end_i may come with a
// byte. A change of hold_toggle_i requests the front bank; from hold_ack_o until cs_ni rises,
// rdata_o and length_o are of that frame.
// Timing: a grant takes two or three clocks; rdata_o follows raddr_i combinationally, on an FPGA at
// the next edge of rclk_i.
// Why a grant wins over a simultaneous release: the late CS belongs to the previous transaction.
`default_nettype none

module dermis_frame_buffer #(
  parameter BANK_BYTES = 2
) (
  input  wire        clk_i,
  input  wire        rst_ni,
  input  wire        begin_i,
  input  wire        we_i,
  input  wire [7:0]  byte_i,
  input  wire        end_i,
  output wire        frame_ready_o,
  output wire [15:0] lost_o,
  input  wire        cs_ni,
  input  wire        hold_toggle_i,
  output wire        hold_ack_o,
  input  wire        rclk_i,
  input  wire [15:0] raddr_i,
  output wire [7:0]  rdata_o,
  output wire [15:0] length_o
);

  reg         front_q;
  reg         held_q;
  reg         hold_ack_q;
  reg         waiting_q;
  reg         ready_q;
  reg  [15:0] waddr_q;
  reg  [15:0] length0_q;
  reg  [15:0] length1_q;
  reg  [15:0] lost_q;

  wire        deselected;
  wire        hold;
  wire        grant;
  wire        free;
  wire        swap;
  wire        lose;
  wire        back;
  wire [15:0] waddr;
  wire [15:0] count;
  wire [7:0]  rdata0;
  wire [7:0]  rdata1;

  dermis_tech_sync u_sync_cs (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (cs_ni),
    .q_o    (deselected)
  );

  dermis_tech_sync u_sync_hold (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (hold_toggle_i),
    .q_o    (hold)
  );

  // A grant while a bank is held: CS was high too briefly to be sampled, so the earlier reader is
  // gone.
  assign grant = hold ^ hold_ack_q;
  assign free  = ~held_q | grant | deselected;

  // A waiting frame becomes readable in the clock of the release, before the next frame begins.
  assign swap  = free & (waiting_q | end_i);
  // A frame that waits is overwritten by the next, an unread one in front replaced by the newer.
  assign lose  = free ? swap & ready_q : waiting_q & begin_i;
  assign back  = ~(front_q ^ (waiting_q & free));
  assign waddr = begin_i ? 16'd0 : waddr_q;
  assign count = waddr + {15'd0, we_i};

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      front_q    <= 1'b0;
      held_q     <= 1'b0;
      hold_ack_q <= 1'b0;
      waiting_q  <= 1'b0;
      ready_q    <= 1'b0;
      waddr_q    <= 16'd0;
      length0_q  <= 16'd0;
      length1_q  <= 16'd0;
      lost_q     <= 16'd0;
    end else begin
      hold_ack_q <= hold;
      waddr_q    <= count;

      if (grant)           held_q <= 1'b1;
      else if (deselected) held_q <= 1'b0;

      if (grant)     ready_q <= 1'b0;
      else if (swap) ready_q <= 1'b1;

      if (swap) front_q <= ~front_q;
      waiting_q <= ~free & (end_i | (waiting_q & ~begin_i));

      if (end_i && !back) length0_q <= count;
      if (end_i && back)  length1_q <= count;

      if (lose && !(&lost_q)) lost_q <= lost_q + 16'd1;
    end

  dermis_tech_ram #(.WORDS (BANK_BYTES)) u_bank0 (
    .clk_i   (clk_i),
    .we_i    (we_i & ~back),
    .waddr_i (waddr),
    .wdata_i (byte_i),
    .rclk_i  (rclk_i),
    .raddr_i (raddr_i),
    .rdata_o (rdata0)
  );

  dermis_tech_ram #(.WORDS (BANK_BYTES)) u_bank1 (
    .clk_i   (clk_i),
    .we_i    (we_i & back),
    .waddr_i (waddr),
    .wdata_i (byte_i),
    .rclk_i  (rclk_i),
    .raddr_i (raddr_i),
    .rdata_o (rdata1)
  );

  assign frame_ready_o = ready_q;
  assign lost_o        = lost_q;
  assign hold_ack_o    = hold_ack_q;
  assign rdata_o       = front_q ? rdata1 : rdata0;
  assign length_o      = front_q ? length1_q : length0_q;

endmodule

`default_nettype wire
