// SPDX-License-Identifier: Apache-2.0
// Theorems of the register map: an access reaches one register, and no bit outside the map.
// Interface: accesses and read-only words are free at every clock.
// Timing: one step is one clock.
// Why a reference of 256 words with write masks: the map is then a table, as in docs/registers.md.
`include "dermis_design.vh"
`default_nettype none

module check_registers #(
  parameter ROWS      = 5,
  parameter COLS      = 3,
  parameter CODE_BITS = 4
) (
  input wire            clk_i,
  input wire            rst_ni,
  input wire            valid_i,
  input wire            write_i,
  input wire [7:0]      address_i,
  input wire [15:0]     wdata_i,
  input wire [5:0]      status_i,
  input wire [15:0]     frame_number_i,
  input wire [15:0]     lost_i,
  input wire [15:0]     spi_errors_i,
  input wire [15:0]     test_count_i,
  input wire [ROWS-1:0] row_fault_i,
  input wire [COLS-1:0] inject_fault_i,
  input wire [COLS-1:0] dark_fault_i,
  input wire [COLS-1:0] full_fault_i
);

  wire                      continuous;
  wire                      dark;
  wire                      hold;
  wire [1:0]                pedestal_mode;
  wire                      range_per_column;
  wire [15:0]               settle;
  wire [15:0]               gate;
  wire [1:0]                range;
  wire [15:0]               test_rate;
  wire [15:0]               dark_max;
  wire [15:0]               full_min;
  wire [ROWS-1:0]           row_mask;
  wire [2*COLS-1:0]         range_column;
  wire [CODE_BITS*COLS-1:0] pedestal;
  wire                      shot;
  wire                      test;
  wire [15:0]               rdata;
  wire                      error;

  dermis_registers #(.ROWS (ROWS), .COLS (COLS), .CODE_BITS (CODE_BITS)) u_dut (
    .clk_i              (clk_i),
    .rst_ni             (rst_ni),
    .valid_i            (valid_i),
    .write_i            (write_i),
    .address_i          (address_i),
    .wdata_i            (wdata_i),
    .continuous_o       (continuous),
    .dark_o             (dark),
    .hold_o             (hold),
    .pedestal_mode_o    (pedestal_mode),
    .range_per_column_o (range_per_column),
    .settle_o           (settle),
    .gate_o             (gate),
    .range_o            (range),
    .test_rate_o        (test_rate),
    .dark_max_o         (dark_max),
    .full_min_o         (full_min),
    .row_mask_o         (row_mask),
    .range_column_o     (range_column),
    .pedestal_o         (pedestal),
    .shot_o             (shot),
    .test_o             (test),
    .scanning_i         (status_i[0]),
    .frame_ready_i      (status_i[1]),
    .test_done_i        (status_i[2]),
    .fault_i            (status_i[3]),
    .test_cut_i         (status_i[4]),
    .underflow_i        (status_i[5]),
    .frame_number_i     (frame_number_i),
    .lost_i             (lost_i),
    .spi_errors_i       (spi_errors_i),
    .test_count_i       (test_count_i),
    .row_fault_i        (row_fault_i),
    .inject_fault_i     (inject_fault_i),
    .dark_fault_i       (dark_fault_i),
    .full_fault_i       (full_fault_i),
    .rdata_o            (rdata),
    .error_o            (error)
  );

  // Lists as 128 lanes.
  wire [127:0] row_faults    = {{(128-ROWS){1'b0}}, row_fault_i};
  wire [127:0] inject_faults = {{(128-COLS){1'b0}}, inject_fault_i};
  wire [127:0] dark_faults   = {{(128-COLS){1'b0}}, dark_fault_i};
  wire [127:0] full_faults   = {{(128-COLS){1'b0}}, full_fault_i};
  wire [127:0] row_masks     = {{(128-ROWS){1'b0}}, row_mask};
  wire [255:0] ranges        = {{(256-2*COLS){1'b0}}, range_column};

  reg started_q = 1'b0;
  always @(posedge clk_i) started_q <= 1'b1;

  // Every state bit at the ports, and its value one clock ago.
  wire [5:0]   control = {hold, range_per_column, pedestal_mode, dark, continuous};
  wire [103:0] words   = {full_min, dark_max, test_rate, gate, settle, {14'd0, range}, 2'd0, control};
  wire [ROWS+(2+CODE_BITS)*COLS+103:0] state = {row_mask, range_column, pedestal, words};
  reg  [ROWS+(2+CODE_BITS)*COLS+103:0] state_q;
  reg          accessed_q;
  reg          wrote_q;
  reg          out_of_reset_q;
  reg  [7:0]   address_q;
  reg  [15:0]  wdata_q;
  always @(posedge clk_i) begin
    state_q        <= state;
    accessed_q     <= valid_i;
    wrote_q        <= valid_i & write_i;
    address_q      <= address_i;
    wdata_q        <= wdata_i;
    out_of_reset_q <= rst_ni;
  end

  // The lanes that exist, of lists of 128.
  localparam [127:0] ROW_BITS   = {ROWS{1'b1}};
  localparam [255:0] RANGE_BITS = {(2*COLS){1'b1}};

  // Writable bits of a word, and existence of the address: the table of docs/registers.md.
  function [15:0] writable;
    input [7:0] address;
    begin
      writable = 16'h0000;
      if (address == 8'h03) writable = 16'h00F9;
      if (address == 8'h04 || address == 8'h05 || address == 8'h0B || address == 8'h0D || address == 8'h0E) writable = 16'hFFFF;
      if (address == 8'h06) writable = 16'h0003;
      if (address >= 8'h20 && address < 8'h28) writable = ROW_BITS >> {address[2:0], 4'd0};
      if (address >= 8'h50 && address < 8'h60) writable = RANGE_BITS >> {address[3:0], 4'd0};
      if (address >= 8'h80 && address < 8'h80 + COLS) writable = (17'd1 << CODE_BITS) - 17'd1;
    end
  endfunction
  function read_only;
    input [7:0] address;
    read_only = (address <= 8'h02) || (address >= 8'h07 && address <= 8'h0A) || address == 8'h0C
      || (address >= 8'h28 && address < 8'h28 + (ROWS + 15) / 16) || (address >= 8'h30 && address < 8'h30 + (COLS + 15) / 16)
      || (address >= 8'h38 && address < 8'h38 + (COLS + 15) / 16) || (address >= 8'h40 && address < 8'h40 + (COLS + 15) / 16);
  endfunction

  // Count of a column at full scale: every second clock of the gate, saturated.
  localparam FULL = (`DERMIS_GATE_CLOCKS / 2 < (2 << CODE_BITS)) ? `DERMIS_GATE_CLOCKS / 2 : (2 << CODE_BITS) - 1;

  // Any one address: its read value from the last write through the mask.
  (* anyconst *) wire [7:0] one;
  wire [15:0] bits = writable(one);
  reg  [15:0] word_q;
  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni)
      word_q <= one == 8'h03 ? 16'h0001 : one == 8'h04 ? `DERMIS_SETTLE_CLOCKS : one == 8'h05 ? `DERMIS_GATE_CLOCKS
              : one == 8'h06 ? 16'd2 : one == 8'h0B ? 16'h4000 : one == 8'h0D ? (FULL + 31) / 32
              : one == 8'h0E ? FULL * 18 / 25
              : one[7:3] == 5'h04 ? bits : one[7:4] == 4'h5 ? (16'hAAAA & bits) : 16'h0000;
    else if (valid_i && write_i && address_i == one) word_q <= wdata_i & bits;

  always @* begin
    if (!started_q) assume (!rst_ni);

    if (started_q && out_of_reset_q && rst_ni && (!wrote_q || writable(address_q) == 0))
      only_a_write_changes: assert (state == state_q);
    if (valid_i && address_i == one && bits != 0) reads_what_was_written: assert (rdata == word_q && !error);
    if (valid_i && writable(address_i) == 0) refuses: assert (error == (write_i || !read_only(address_i)));
    if (valid_i) reserved_bits_read_0: assert ((rdata & ~(writable(address_i) | {16{read_only(address_i)}})) == 0);
    if (!valid_i) quiet: assert (rdata == 0 && !error && !shot && !test);
    pulses: assert (shot == (valid_i && write_i && address_i == 8'h03 && wdata_i[1])
      && test == (valid_i && write_i && address_i == 8'h03 && wdata_i[2]));
    if (valid_i && !write_i) reads_what_is_measured: assert (
        address_i == 8'h00 ? rdata == 16'hDE01 : address_i == 8'h01 ? rdata == {ROWS[7:0], COLS[7:0]}
      : address_i == 8'h02 ? rdata == {7'd1, 1'b0, 3'd0, CODE_BITS[4:0]} : address_i == 8'h07 ? rdata == {10'd0, status_i}
      : address_i == 8'h08 ? rdata == frame_number_i : address_i == 8'h09 ? rdata == lost_i : address_i == 8'h0A ? rdata == spi_errors_i
      : address_i == 8'h0C ? rdata == test_count_i : !read_only(address_i) ? 1'b1 : rdata == (address_i[7:3] == 5'h05 ? row_faults >> {address_i[2:0], 4'd0}
      : address_i[7:3] == 5'h06 ? inject_faults >> {address_i[2:0], 4'd0} : address_i[7:3] == 5'h07 ? dark_faults >> {address_i[2:0], 4'd0}
      : full_faults >> {address_i[2:0], 4'd0}) % 65536);
    // The ports show the words: the chip uses the values that an address reads.
    if (one == 8'h03) port_control: assert (control == {word_q[7:3], word_q[0]});
    if (one == 8'h04) port_settle: assert (settle == word_q);
    if (one == 8'h05) port_gate: assert (gate == word_q);
    if (one == 8'h06) port_range: assert (range == word_q);
    if (one == 8'h0B) port_test_rate: assert (test_rate == word_q);
    if (one == 8'h0D) port_dark_max: assert (dark_max == word_q);
    if (one == 8'h0E) port_full_min: assert (full_min == word_q);
    if (one[7:3] == 5'h04) port_row_mask: assert ((row_masks >> {one[2:0], 4'd0}) % 65536 == word_q);
    if (one[7:4] == 4'h5) port_range_column: assert ((ranges >> {one[3:0], 4'd0}) % 65536 == word_q);
    if (one >= 8'h80 && one < 8'h80 + COLS) port_pedestal: assert (((pedestal >> (CODE_BITS * (one - 8'h80))) & bits) == word_q);

    lemma_word: assert ((word_q & ~bits) == 0);

    written: cover (rst_ni && started_q && one == 8'h82 && pedestal[CODE_BITS*3-1:CODE_BITS*2] == 4'hA && wrote_q);
    refused: cover (rst_ni && valid_i && write_i && error && address_i == 8'h80 + COLS);
    control_written: cover (rst_ni && started_q && wrote_q && address_q == 8'h03 && control == 6'h3E);
  end

endmodule

`default_nettype wire
