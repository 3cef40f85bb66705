  // SPDX-License-Identifier: Apache-2.0
  // Function of DP16KD, whose ports Yosys declares without one: 2048 x 9, port A writes, port B reads.
  // Other widths and output registers are not modelled; the netlist uses neither.
  reg [8:0] mem [0:2047];
  reg [8:0] read_q;

  initial if (DATA_WIDTH_A != 9 || DATA_WIDTH_B != 9 || REGMODE_B != "NOREG") begin
    $display("dp16kd.vh: this mode of DP16KD is not modelled");
    $finish;
  end

  always @(posedge CLKA)
    if (CEA && WEA)
      mem[{ADA13, ADA12, ADA11, ADA10, ADA9, ADA8, ADA7, ADA6, ADA5, ADA4, ADA3}]
        <= {DIA8, DIA7, DIA6, DIA5, DIA4, DIA3, DIA2, DIA1, DIA0};

  always @(posedge CLKB)
    if (CEB)
      read_q <= mem[{ADB13, ADB12, ADB11, ADB10, ADB9, ADB8, ADB7, ADB6, ADB5, ADB4, ADB3}];

  assign {DOB8, DOB7, DOB6, DOB5, DOB4, DOB3, DOB2, DOB1, DOB0} = read_q;
