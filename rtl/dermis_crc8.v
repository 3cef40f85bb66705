// SPDX-License-Identifier: Apache-2.0
// CRC-8/SMBUS after one more byte: polynomial x^8 + x^2 + x + 1, most significant bit first, start
// 0.
// Interface: crc_o follows crc_i and data_i; the register is outside.
// Timing: combinational.
// Why eight bits: in a command of four bytes it detects all errors of up to three bits and bursts
// of eight.
`default_nettype none

module dermis_crc8 (
  input  wire [7:0] crc_i,
  input  wire [7:0] data_i,
  output wire [7:0] crc_o
);

  wire [7:0] x;

  assign x = crc_i ^ data_i;

  // Columns of the remainder table: bit n of the sum enters the remainders of 2^(n+8).
  assign crc_o[0] = x[0] ^ x[6] ^ x[7];
  assign crc_o[1] = x[0] ^ x[1] ^ x[6];
  assign crc_o[2] = x[0] ^ x[1] ^ x[2] ^ x[6];
  assign crc_o[3] = x[1] ^ x[2] ^ x[3] ^ x[7];
  assign crc_o[4] = x[2] ^ x[3] ^ x[4];
  assign crc_o[5] = x[3] ^ x[4] ^ x[5];
  assign crc_o[6] = x[4] ^ x[5] ^ x[6];
  assign crc_o[7] = x[5] ^ x[6] ^ x[7];

endmodule

`default_nettype wire
