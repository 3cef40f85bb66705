// SPDX-License-Identifier: Apache-2.0
// Analog user area of Caravan: digital core and analog front end of an 8x8 array, connected to the pads.
// Interface: ports of Caravan; pads in docs/handover.md. Clock user_clock2, reset wb_rst_i, host mprj_io[9:5]. With
// DERMIS_MACRO the core is a hardened 8x8 macro without parameters; with USE_POWER_PINS it has supply pins.
// Timing: rtl/synth/dermis.sdc constrains u_core; only wires are added here.
// Why 8x8: 16x16 takes 32 analog pads and Caravan has 29, mprj_io[35:7].
`default_nettype none

`ifndef MPRJ_IO_PADS
`define MPRJ_IO_PADS 38
`endif
`ifndef ANALOG_PADS
`define ANALOG_PADS 11
`endif

module user_analog_project_wrapper (
`ifdef USE_POWER_PINS
  inout  wire                                      vdda1,
  inout  wire                                      vdda2,
  inout  wire                                      vssa1,
  inout  wire                                      vssa2,
  inout  wire                                      vccd1,
  inout  wire                                      vccd2,
  inout  wire                                      vssd1,
  inout  wire                                      vssd2,
`endif
  input  wire                                      wb_clk_i,
  input  wire                                      wb_rst_i,
  input  wire                                      wbs_stb_i,
  input  wire                                      wbs_cyc_i,
  input  wire                                      wbs_we_i,
  input  wire [3:0]                                wbs_sel_i,
  input  wire [31:0]                               wbs_dat_i,
  input  wire [31:0]                               wbs_adr_i,
  output wire                                      wbs_ack_o,
  output wire [31:0]                               wbs_dat_o,
  input  wire [127:0]                              la_data_in,
  output wire [127:0]                              la_data_out,
  input  wire [127:0]                              la_oenb,
  input  wire [`MPRJ_IO_PADS-`ANALOG_PADS-1:0]     io_in,
  input  wire [`MPRJ_IO_PADS-`ANALOG_PADS-1:0]     io_in_3v3,
  output wire [`MPRJ_IO_PADS-`ANALOG_PADS-1:0]     io_out,
  output wire [`MPRJ_IO_PADS-`ANALOG_PADS-1:0]     io_oeb,
  inout  wire [`MPRJ_IO_PADS-`ANALOG_PADS-10:0]    gpio_analog,
  inout  wire [`MPRJ_IO_PADS-`ANALOG_PADS-10:0]    gpio_noesd,
  inout  wire [`ANALOG_PADS-1:0]                   io_analog,
  inout  wire [2:0]                                io_clamp_high,
  inout  wire [2:0]                                io_clamp_low,
  input  wire                                      user_clock2,
  output wire [2:0]                                user_irq
);

  localparam ROWS = 8;
  localparam COLS = 8;
  localparam PADS = `MPRJ_IO_PADS - `ANALOG_PADS;

  // Indices, not pads: io_in[n] is mprj_io[n] up to 13, then mprj_io[n + 11]; gpio_noesd[n] is mprj_io[n + 7] up to 6,
  // then mprj_io[n + 18]; io_analog[n] is mprj_io[n + 14]. Rows on mprj_io[32:25] are apart from columns and host.
  // gpio_analog[n] is the same pad behind 150 ohm, which would leave code 75 of 251; gpio_noesd[n] has neither resistor
  // nor clamp, so the front end clamps its rows.
  localparam SCK    = 5;
  localparam CS_N   = 6;
  localparam COPI   = 7;
  localparam CIPO   = 8;
  localparam READY  = 9;
  localparam ENABLE = 10;
  localparam ROW_0  = 7;
  localparam VREF   = 4;

  wire [COLS-1:0]   comp;
  wire [ROWS-1:0]   row_sense;
  wire [ROWS-1:0]   row_select;
  wire              preset;
  wire [COLS-1:0]   charge;
  wire [2*COLS-1:0] range;
  wire [COLS-1:0]   test_current;
  wire              frame_start;
  wire              cipo;
  wire              cipo_oe;
  wire              frame_ready;

`ifdef DERMIS_MACRO
  dermis_top u_core (
`ifdef USE_POWER_PINS
    .vccd1          (vccd1),
    .vssd1          (vssd1),
`endif
`else
  dermis_top #(
    .ROWS (ROWS),
    .COLS (COLS)
  ) u_core (
`endif
    .clk_i          (user_clock2),
    .rst_ni         (~wb_rst_i),
    .enable_i       (io_in[ENABLE]),
    .comp_async_i   (comp),
    .row_sense_i    (row_sense),
    .row_select_o   (row_select),
    .preset_o       (preset),
    .charge_o       (charge),
    .range_o        (range),
    .test_current_o (test_current),
    .frame_start_o  (frame_start),
    .spi_sck_i      (io_in[SCK]),
    .spi_cs_ni      (io_in[CS_N]),
    .spi_copi_i     (io_in[COPI]),
    .spi_cipo_o     (cipo),
    .spi_cipo_oe_o  (cipo_oe),
    .frame_ready_o  (frame_ready)
  );

  dermis_analog_front_end #(
    .ROWS (ROWS),
    .COLS (COLS)
  ) u_front_end (
`ifdef USE_POWER_PINS
    .vdd      (vdda1),
    .vss      (vssa1),
    .vdd_d    (vccd1),
    .vss_d    (vssd1),
`endif
    .row      (gpio_noesd[ROW_0 +: ROWS]),
    .col      (io_analog[COLS-1:0]),
    .vbias    (io_analog[COLS]),
    .r_ref    (io_analog[COLS+1]),
    .agnd     (io_analog[COLS+2]),
    .vref     (gpio_analog[VREF]),
    .d_enable (~wb_rst_i),
    .d_row    (row_select),
    .d_sense  (row_sense),
    .d_preset (preset),
    .d_charge (charge),
    .d_range  (range),
    .d_test   (test_current),
    .comp     (comp)
  );

  // Unused pads are inputs; oeb is low for an output.
  genvar n;
  generate
    for (n = 0; n < PADS; n = n + 1) begin : gen_pad
      assign io_out[n] = (n == CIPO) ? cipo : (n == READY) ? frame_ready : 1'b0;
      assign io_oeb[n] = (n == CIPO) ? ~cipo_oe : (n == READY) ? 1'b0 : 1'b1;
    end
  endgenerate

  // The management core may observe and get an interrupt; it has no other access: the host is the SPI.
  assign wbs_ack_o   = 1'b0;
  assign wbs_dat_o   = 32'd0;
  assign la_data_out = {125'd0, frame_start, preset, frame_ready};
  assign user_irq    = {2'd0, frame_ready};

  wire unused_caravan;
  assign unused_caravan = &{1'b0, wb_clk_i, wbs_stb_i, wbs_cyc_i, wbs_we_i, wbs_sel_i, wbs_dat_i, wbs_adr_i, la_data_in, la_oenb,
                            io_in, io_in_3v3, gpio_analog, gpio_noesd, io_analog, io_clamp_high, io_clamp_low
`ifdef USE_POWER_PINS
                            , vdda2, vssa2, vccd2, vssd2
`endif
                            };

endmodule

`default_nettype wire
