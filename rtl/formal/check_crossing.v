// SPDX-License-Identifier: Apache-2.0
// Theorems of both clock domains together: SPI peripheral, register port and frame buffer.
// Interface: both clocks (any phase and ratio), CS, COPI, reset and frames are free at every step of a global clock.
// Timing: a step is any part of a period of either clock. Every synchronizer may take its input a clock late.
// Why the whole peripheral and not a model: the theorems depend on the time of its requests.
`default_nettype none

module check_crossing #(
  // For searches only: no further reset, SCK changes at every step.
  parameter SEARCH = 0
) (
  input wire        clk_i,
  input wire        rst_ni,
  input wire        sck_i,
  input wire        cs_ni,
  input wire        copi_i,
  input wire [15:0] rdata_i,
  input wire        error_i,
  input wire        begin_i,
  input wire        we_i,
  input wire        end_i
);

  (* gclk *) reg global;

  wire        request;
  wire        write;
  wire [7:0]  address;
  wire [15:0] wdata;
  wire        ack;
  wire [15:0] rdata;
  wire        refused;
  wire        hold;
  wire        hold_ack;
  wire [15:0] frame_address;
  wire [7:0]  frame_data;
  wire [15:0] frame_length;
  wire        error;
  wire        valid;
  wire        bus_write;
  wire [7:0]  bus_address;
  wire [15:0] bus_wdata;

  dermis_spi u_spi (
    .rst_ni           (rst_ni),
    .sck_i            (sck_i),
    .cs_ni            (cs_ni),
    .copi_i           (copi_i),
    .cipo_o           (),
    .cipo_oe_o        (),
    .request_toggle_o (request),
    .write_o          (write),
    .address_o        (address),
    .wdata_o          (wdata),
    .ack_toggle_i     (ack),
    .rdata_i          (rdata),
    .refused_i        (refused),
    .hold_toggle_o    (hold),
    .hold_ack_i       (hold_ack),
    .frame_address_o  (frame_address),
    .frame_data_i     (frame_data),
    .frame_length_i   (frame_length),
    .error_toggle_o   (error)
  );

  dermis_register_port u_port (
    .clk_i            (clk_i),
    .rst_ni           (rst_ni),
    .request_toggle_i (request),
    .write_i          (write),
    .address_i        (address),
    .wdata_i          (wdata),
    .ack_toggle_o     (ack),
    .rdata_o          (rdata),
    .refused_o        (refused),
    .error_toggle_i   (error),
    .errors_o         (),
    .valid_o          (valid),
    .write_o          (bus_write),
    .address_o        (bus_address),
    .wdata_o          (bus_wdata),
    .rdata_i          (rdata_i),
    .error_i          (error_i)
  );

  dermis_frame_buffer #(.BANK_BYTES (2)) u_buffer (
    .clk_i         (clk_i),
    .rst_ni        (rst_ni),
    .begin_i       (begin_i),
    .we_i          (we_i),
    .byte_i        (8'h00),
    .end_i         (end_i),
    .frame_ready_o (),
    .lost_o        (),
    .cs_ni         (cs_ni),
    .hold_toggle_i (hold),
    .hold_ack_o    (hold_ack),
    .raddr_i       (frame_address),
    .rdata_o       (frame_data),
    .length_o      (frame_length)
  );

  // Internal signals, for the proof only.
  wire [3:0] tap_state;
  wire       tap_front;
  wire       tap_held;
  wire       tap_we0;
  wire       tap_we1;

  reg        started_q = 1'b0;
  reg        clk_q;
  reg        sck_q;
  reg        cs_nq;
  reg        rst_nq;
  reg        request_q;
  reg        valid_q;
  reg        pending_q;
  reg        front_q;
  reg        reading_q;
  reg [24:0] payload_q;
  reg [2:0]  waits_q;
  wire       reading = (tap_state == 4'd11) | (tap_state == 4'd12) | (tap_state == 4'd13);

  always @(posedge global) begin
    started_q <= 1'b1;
    clk_q     <= clk_i;
    sck_q     <= sck_i;
    cs_nq     <= cs_ni;
    rst_nq    <= rst_ni;
    request_q <= request;
    valid_q   <= valid;
    front_q   <= tap_front;
    reading_q <= reading & ~cs_ni;
    if (request != request_q) payload_q <= {write, address, wdata};
    // A pending command: sent by the SPI domain, not yet at the registers.
    if (!rst_ni)                                pending_q <= 1'b0;
    else if (request != request_q)              pending_q <= 1'b1;
    else if (valid_q && clk_i && !clk_q)        pending_q <= 1'b0;
    if (!rst_ni || !pending_q)                  waits_q <= 3'd0;
    else if (clk_i && !clk_q)                   waits_q <= waits_q + 3'd1;
  end
  wire alive = started_q & rst_ni & rst_nq;

  always @(posedge global) begin
    if (!started_q) assume (!rst_ni && cs_ni && !sck_i && !clk_i);
    if (started_q && sck_i && !sck_q) assume (cs_ni == cs_nq && rst_ni == rst_nq);
    if (started_q && clk_i && !clk_q) assume (rst_ni == rst_nq);
    if (SEARCH != 0 && started_q) assume (rst_ni && sck_i == (!sck_q && rst_nq));

    // While length and bytes are sent, their bank stays the front bank, held and not written.
    if (alive && reading && !cs_ni) bank_is_held: assert (tap_held && !(tap_front ? tap_we1 : tap_we0));
    if (alive && reading && reading_q && !cs_ni) bank_stays: assert (tap_front == front_q);
    // One access for each command, with its payload, within four edges.
    if (alive && request != request_q) one_at_a_time: assert (!pending_q);
    if (alive && pending_q && request == request_q) payload_rests: assert ({write, address, wdata} == payload_q);
    if (alive && clk_i && !clk_q && valid_q) one_access_a_command: assert (pending_q && {bus_write, bus_address, bus_wdata} == payload_q);
    if (alive) access_comes: assert (waits_q <= 4);

    never_accessed: assert (!(alive && clk_i && !clk_q && valid_q));
    never_reads_a_byte: assert (!(alive && tap_state == 4'd13));
  end

endmodule

`default_nettype wire
