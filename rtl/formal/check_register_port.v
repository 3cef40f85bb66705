// SPDX-License-Identifier: Apache-2.0
// Theorems of the register port: one access per request, a stable answer, and counted refusals.
// Interface: toggles of requests and answers of registers are free at every clock.
// Timing: one step is one clock.
// Why toggles without the protocol of the peripheral: the claim is one access per change, at any rate of changes.
`default_nettype none

module check_register_port (
  input wire        clk_i,
  input wire        rst_ni,
  input wire        request_i,
  input wire        error_toggle_i,
  input wire        write_i,
  input wire [7:0]  address_i,
  input wire [15:0] wdata_i,
  input wire [15:0] rdata_i,
  input wire        error_i
);

  wire        ack;
  wire [15:0] rdata;
  wire        refused;
  wire [15:0] errors;
  wire        valid;
  wire        write;
  wire [7:0]  address;
  wire [15:0] wdata;

  dermis_register_port u_dut (
    .clk_i            (clk_i),
    .rst_ni           (rst_ni),
    .request_toggle_i (request_i),
    .write_i          (write_i),
    .address_i        (address_i),
    .wdata_i          (wdata_i),
    .ack_toggle_o     (ack),
    .rdata_o          (rdata),
    .refused_o        (refused),
    .error_toggle_i   (error_toggle_i),
    .errors_o         (errors),
    .valid_o          (valid),
    .write_o          (write),
    .address_o        (address),
    .wdata_o          (wdata),
    .rdata_i          (rdata_i),
    .error_i          (error_i)
  );

  // Internal signals, for the induction only.
  wire tap_request;
  wire tap_request1;
  wire tap_error;
  wire tap_error1;
  wire tap_error2;

  reg        started_q = 1'b0;
  reg [2:0]  seen_q;
  reg [2:0]  errors_seen_q;
  reg [16:0] answer_q;
  reg [15:0] count_q;
  always @(posedge clk_i) started_q <= 1'b1;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      seen_q        <= 3'b000;
      errors_seen_q <= 3'b000;
      answer_q      <= 17'd0;
      count_q       <= 16'd0;
    end else begin
      seen_q        <= {seen_q[1:0], request_i};
      errors_seen_q <= {errors_seen_q[1:0], error_toggle_i};
      if (seen_q[2] != seen_q[1]) answer_q <= {error_i, rdata_i};
      if (errors_seen_q[2] != errors_seen_q[1] && count_q != 16'hFFFF) count_q <= count_q + 16'd1;
    end

  always @* begin
    if (!started_q) assume (!rst_ni);
    one_access: assert (valid == (seen_q[2] != seen_q[1]) && ack == seen_q[2]);
    passes_the_command: assert ({write, address, wdata} == {write_i, address_i, wdata_i});
    answers: assert ({refused, rdata} == answer_q);
    counts_errors: assert (errors == count_q);

    lemma_request: assert (tap_request == seen_q[1] && tap_request1 == seen_q[0]);
    lemma_error: assert (tap_error == errors_seen_q[1] && tap_error1 == errors_seen_q[0] && tap_error2 == errors_seen_q[2]);

    accessed: cover (rst_ni && ack && refused && rdata == 16'h1234);
    counted: cover (rst_ni && count_q == 16'd3);
  end

endmodule

`default_nettype wire
