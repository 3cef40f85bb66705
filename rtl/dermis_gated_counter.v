// SPDX-License-Identifier: Apache-2.0
// Saturating counter of the rising edges of one column's pulses in a gate.
// Interface: a rising edge of pulse_i counts if gate_i is high at the clock edge that samples it;
// count_o then holds.
// Timing: the first clock of a gate restarts from zero; count_o is final one clock after the gate.
// Why saturating: 512 pulses, or a taxel below full scale, must read full scale and never a small
// number.
`include "dermis_design.vh"
`default_nettype none

module dermis_gated_counter #(
  parameter CODE_BITS = `DERMIS_CODE_BITS
) (
  input  wire                 clk_i,
  input  wire                 rst_ni,
  input  wire                 gate_i,
  input  wire                 pulse_i,
  output wire [CODE_BITS-1:0] count_o
);

  reg                  pulse_q;
  reg                  gate_q;
  reg  [CODE_BITS-1:0] count_q;
  wire [CODE_BITS-1:0] start;
  wire                 rising;

  assign rising = pulse_i & ~pulse_q;
  assign start  = gate_q ? count_q : {CODE_BITS{1'b0}};

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      pulse_q <= 1'b0;
      gate_q  <= 1'b0;
      count_q <= {CODE_BITS{1'b0}};
    end else begin
      pulse_q <= pulse_i;
      gate_q  <= gate_i;
      if (gate_i) begin
        if (rising && !(&start)) count_q <= start + 1'b1;
        else                     count_q <= start;
      end
    end

  assign count_o = count_q;

endmodule

`default_nettype wire
