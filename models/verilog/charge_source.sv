// SPDX-License-Identifier: Apache-2.0
// Charge source: out draws i0 while d_charge is 1; one clock is a packet.
// Effects: PACKET, the packet size of a column.
// Why d_charge is a factor: a choice between two reals compiles to an unpredictable branch and halves the speed.
`include "values.vh"
`default_nettype none

module charge_source #(
  parameter EFFECTS = 0
) (
  input  wire                         d_charge,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output real                         out
);

  generate
    if (EFFECTS[`DERMIS_PACKET]) begin : gen_packet
      real packet;
      assign packet = $bitstoreal(values_i[64*`DERMIS_PACKET +: 64]);
      assign out    = d_charge * packet;
    end else begin : gen_ideal
      assign out    = d_charge;
    end
  endgenerate

endmodule

`default_nettype wire
