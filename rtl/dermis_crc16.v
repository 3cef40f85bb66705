// SPDX-License-Identifier: Apache-2.0
// CRC-16/CCITT-FALSE after one more byte: polynomial 0x1021, most significant bit first, start
// 0xFFFF.
// Interface: crc_o follows crc_i and byte_i; the register is outside.
// Timing: combinational.
// Why no loop over bits: x^16 + x^12 + x^5 + 1 folds into three shifted copies of one byte.
`default_nettype none

module dermis_crc16 (
  input  wire [15:0] crc_i,
  input  wire [7:0]  byte_i,
  output wire [15:0] crc_o
);

  wire [7:0] top;
  wire [7:0] x;

  assign top   = crc_i[15:8] ^ byte_i;
  assign x     = top ^ {4'd0, top[7:4]};
  assign crc_o = {crc_i[7:0], 8'd0} ^ {x[3:0], 12'd0} ^ {3'd0, x, 5'd0} ^ {8'd0, x};

endmodule

`default_nettype wire
