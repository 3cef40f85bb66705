// SPDX-License-Identifier: Apache-2.0
// A comparator that chatters in front of a synchronizer: 1 ps pulses between the edges, and across
// those edges only that covered.txt marks. Writes pulses.txt: rising edges of the synchronized
// output. 200 ns clock, steps of 1 fs.
`timescale 1ps / 1fs
`default_nettype none

module glitch_bench;

  localparam EDGES = 4096;

  reg covered[0:EDGES-1];
  reg clk, rst_n, comparator;
  wire pulse;
  integer pulses, file, n, k;

  dermis_sync_ff u_sync (
    .clk_i        (clk),
    .rst_ni       (rst_n),
    .inhibit_i    (1'b0),
    .comp_async_i (comparator),
    .pulse_o      (pulse)
  );

  always @(posedge pulse) pulses = pulses + 1;

  initial begin
    $readmemb("covered.txt", covered);
    pulses = 0;
    clk = 0;
    comparator = 0;
    rst_n = 0;
    #1000 rst_n = 1;
    for (n = 0; n < EDGES; n = n + 1) begin
      // Three pulses while the clock is low, one that ends 1 ps before the edge, one that begins 1
      // ps behind it.
      for (k = 0; k < 3; k = k + 1) begin
        #30000 comparator = 1;
        #1 comparator = 0;
      end
      #9990 comparator = 1;
      #1 comparator = 0;
      #0.5 comparator = covered[n];
      #0.5 clk = 1;
      #0.5 comparator = 0;
      #1 comparator = 1;
      #1 comparator = 0;
      #99990 clk = 0;
    end
    #200000 clk = 1;  // the second flip-flop shows the last decision a clock later
    #1000;
    file = $fopen("pulses.txt");
    $fdisplay(file, "%0d", pulses);
    $fclose(file);
    $finish;
  end

endmodule

`default_nettype wire
