// SPDX-License-Identifier: Apache-2.0
// Flip-flops and clock of a guest simulator around the analog half of one converter. The flip-flops are the project's.
// Reset ends after clock 1, whose decision is 0 in any case, so that the level that the plug-in has not yet driven is not
// sampled. Icarus 11 does not carry a value that is forced, as by cocotbext-ams, through ports and assignments; a process
// sees it (NO_INSTANCE).
`timescale 1ns/1ps
`ifndef NO_INSTANCE
module bench_analog(input wire d_charge, output wire comp);
endmodule
`endif
module bench_peer;
  parameter CLOCKS = 100;
  reg clk = 1'b0;
  reg rst_n = 1'b1;
  wire d_charge;
  integer n = 0, file;
`ifdef NO_INSTANCE
  reg comp, seen;
  always @(comp) seen = comp;
`else
  wire comp;
  wire seen = comp;
  bench_analog u_analog (.d_charge (d_charge), .comp (comp));
`endif
  dermis_sync_ff u_sync (.clk_i (clk), .rst_ni (rst_n), .inhibit_i (1'b0), .comp_async_i (seen), .pulse_o (d_charge));
  initial begin
    file = $fopen("told.txt");
    #1 rst_n = 1'b0;
    #1499 rst_n = 1'b1;
  end
  always begin
    #500 clk = 1'b0;
    #500 clk = 1'b1;
  end
  always @(posedge clk) begin
    n = n + 1;
    if (n <= CLOCKS) $fdisplay(file, "%b", d_charge);
    if (n == CLOCKS) $fclose(file);
`ifndef NO_INSTANCE
    if (n == CLOCKS + 1) $finish;
`endif
  end
endmodule
