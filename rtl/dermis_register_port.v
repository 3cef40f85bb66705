// SPDX-License-Identifier: Apache-2.0
// Bus side of the SPI requests: each becomes one access of one clock to the registers.
// Interface: request_toggle_i differs from ack_toggle_o during a request; write_i, address_i and
// wdata_i are stable then.
// Timing: valid_o is high for one clock after two or three edges; rdata_o and refused_o change with
// ack_toggle_o.
// Why errors are counted here: their toggle crosses as requests do. Two within three clocks may
// count as none.
`default_nettype none

module dermis_register_port (
  input  wire        clk_i,
  input  wire        rst_ni,
  input  wire        request_toggle_i,
  input  wire        write_i,
  input  wire [7:0]  address_i,
  input  wire [15:0] wdata_i,
  output wire        ack_toggle_o,
  output wire [15:0] rdata_o,
  output wire        refused_o,
  input  wire        error_toggle_i,
  output wire [15:0] errors_o,
  output wire        valid_o,
  output wire        write_o,
  output wire [7:0]  address_o,
  output wire [15:0] wdata_o,
  input  wire [15:0] rdata_i,
  input  wire        error_i
);

  wire        request;
  wire        error;

  reg         ack_q;
  reg  [15:0] rdata_q;
  reg         refused_q;
  reg         error_q;
  reg  [15:0] errors_q;

  dermis_tech_sync u_sync_request (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (request_toggle_i),
    .q_o    (request)
  );

  dermis_tech_sync u_sync_error (
    .clk_i  (clk_i),
    .rst_ni (rst_ni),
    .d_i    (error_toggle_i),
    .q_o    (error)
  );

  assign valid_o = request ^ ack_q;

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      ack_q     <= 1'b0;
      rdata_q   <= 16'd0;
      refused_q <= 1'b0;
      error_q   <= 1'b0;
      errors_q  <= 16'd0;
    end else begin
      ack_q   <= request;
      error_q <= error;
      if (valid_o) begin
        rdata_q   <= rdata_i;
        refused_q <= error_i;
      end
      if ((error ^ error_q) && !(&errors_q)) errors_q <= errors_q + 16'd1;
    end

  assign ack_toggle_o = ack_q;
  assign rdata_o      = rdata_q;
  assign refused_o    = refused_q;
  assign errors_o     = errors_q;
  assign write_o      = write_i;
  assign address_o    = address_i;
  assign wdata_o      = wdata_i;

endmodule

`default_nettype wire
