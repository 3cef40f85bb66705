// SPDX-License-Identifier: Apache-2.0
// Packs the rows of a frame into bytes: header, slots of codes less pedestal, overflow bits, CRC-16
// (docs/rtl.md).
// Interface: row_valid_i offers a row, count_shift_o takes its columns in order, busy_o is high
// until all are taken. begin_o opens a frame, we_o writes byte_o, end_o closes it; column_valid_o
// marks the raw count of column_o. underflow_o: a pedestal was above a count of the latest whole
// frame.
// Timing: begin_o with row_valid_i of the first row, then one byte a clock, end_o one clock after
// the last.
// Why the pedestal mode comes with the row: the scanner samples it with all other settings of a
// frame.
`include "dermis_design.vh"
`default_nettype none

module dermis_packer #(
  parameter COLS      = `DERMIS_COLS,
  parameter CODE_BITS = `DERMIS_CODE_BITS
) (
  input  wire                      clk_i,
  input  wire                      rst_ni,
  input  wire                      row_valid_i,
  input  wire [7:0]                slot_i,
  input  wire                      first_i,
  input  wire                      last_i,
  input  wire                      test_frame_i,
  input  wire                      dark_frame_i,
  input  wire [1:0]                pedestal_mode_i,
  input  wire [15:0]               gate_clocks_i,
  input  wire [CODE_BITS:0]        count_i,
  output wire                      count_shift_o,
  output wire                      busy_o,
  input  wire [COLS*CODE_BITS-1:0] pedestal_i,
  input  wire                      fault_i,
  output wire [15:0]               frame_number_o,
  output wire                      begin_o,
  output wire                      we_o,
  output wire [7:0]                byte_o,
  output wire                      end_o,
  output wire                      underflow_o,
  output wire                      column_valid_o,
  output wire [6:0]                column_o,
  output wire [CODE_BITS:0]        column_count_o,
  output wire [7:0]                column_slot_o
);

  localparam [2:0] IDLE   = 3'd0;
  localparam [2:0] HEADER = 3'd1;
  localparam [2:0] SLOT   = 3'd2;
  localparam [2:0] CODES  = 3'd3;
  localparam [2:0] OVERS  = 3'd4;
  localparam [2:0] CRC    = 3'd5;

  localparam [7:0] FORMAT = 8'h01;
  localparam [7:0] DARK   = 8'hF1;

  localparam integer LAST_COLUMN = COLS - 1;
  localparam integer LAST_OVER   = (COLS + 7) / 8 - 1;
  localparam integer OVER_BITS   = 8 * (LAST_OVER + 1);
  localparam         WIDE        = (CODE_BITS > 8) ? 1'b1 : 1'b0;

  reg [2:0]                phase_q;
  reg [6:0]                index_q;
  reg                      low_q;
  reg [15:0]               frame_number_q;
  reg [15:0]               crc_q;
  reg [OVER_BITS-1:0]      over_q;
  reg [COLS*CODE_BITS-1:0] ring_q;
  reg                      end_q;
  reg                      under_q;
  reg                      underflow_q;

  reg  [7:0]                    header;
  reg  [7:0]                    data;
  reg  [CODE_BITS-1:0]          pedestal;
  wire [15:0]                   crc;
  wire [1:0]                    mode;
  wire                          special;
  wire [CODE_BITS+1:0]          difference;
  wire                          over;
  wire                          under;
  wire [CODE_BITS-1:0]          code;
  wire [15:0]                   code_wide;
  wire                          taken;
  wire [CODE_BITS-1:0]          ring_word;

  assign mode       = (pedestal_mode_i == 2'd3) ? 2'd0 : pedestal_mode_i;
  assign special    = (slot_i[7:4] == 4'hF);
  assign difference = {1'b0, count_i} - {2'b00, pedestal};
  assign under      = difference[CODE_BITS+1];
  assign over       = ~under & difference[CODE_BITS];
  assign code       = under                 ? {CODE_BITS{1'b0}}
                    : over                    ? {CODE_BITS{1'b1}}
                    :                           difference[CODE_BITS-1:0];
  assign code_wide  = {{(16-CODE_BITS){1'b0}}, code};
  assign taken      = (phase_q == CODES) & (low_q | ~WIDE);

  assign ring_word  = (slot_i == DARK) ? code : ring_q[CODE_BITS-1:0];

  always @*
    if (special)             pedestal = {CODE_BITS{1'b0}};
    else if (mode == 2'd1) pedestal = pedestal_i[index_q*CODE_BITS +: CODE_BITS];
    else if (mode == 2'd2) pedestal = ring_q[CODE_BITS-1:0];
    else                     pedestal = {CODE_BITS{1'b0}};

  always @*
    case (index_q[2:0])
      3'd0:    header = FORMAT;
      3'd1:    header = {3'd0, fault_i, dark_frame_i, mode, test_frame_i};
      3'd2:    header = frame_number_q[15:8];
      3'd3:    header = frame_number_q[7:0];
      3'd4:    header = COLS[7:0];
      3'd5:    header = CODE_BITS[7:0];
      3'd6:    header = gate_clocks_i[15:8];
      default: header = gate_clocks_i[7:0];
    endcase

  always @*
    case (phase_q)
      HEADER:  data = header;
      SLOT:    data = slot_i;
      CODES:   data = taken ? code_wide[7:0] : code_wide[15:8];
      OVERS:   data = over_q[7:0];
      default: data = index_q[0] ? crc_q[7:0] : crc_q[15:8];
    endcase

  dermis_crc16 u_crc (
    .crc_i  (crc_q),
    .byte_i (data),
    .crc_o  (crc)
  );

  always @(posedge clk_i or negedge rst_ni)
    if (!rst_ni) begin
      phase_q        <= IDLE;
      index_q        <= 7'd0;
      low_q          <= 1'b0;
      frame_number_q <= 16'd0;
      crc_q          <= 16'd0;
      over_q         <= {OVER_BITS{1'b0}};
      ring_q         <= {(COLS*CODE_BITS){1'b0}};
      end_q          <= 1'b0;
      under_q        <= 1'b0;
      underflow_q    <= 1'b0;
    end else begin
      end_q <= 1'b0;
      if (phase_q != IDLE && phase_q != CRC) crc_q <= crc;
      case (phase_q)
        IDLE: begin
          index_q <= 7'd0;
          if (row_valid_i) begin
            phase_q <= first_i ? HEADER : SLOT;
            if (first_i) begin
              frame_number_q <= frame_number_q + 16'd1;
              crc_q          <= 16'hFFFF;
              under_q        <= 1'b0;
            end
          end
        end
        HEADER: begin
          index_q <= index_q + 7'd1;
          if (index_q == 7'd7) phase_q <= SLOT;
        end
        SLOT: begin
          phase_q <= CODES;
          index_q <= 7'd0;
          low_q   <= 1'b0;
        end
        CODES: begin
          low_q <= ~low_q;
          if (taken) begin
            low_q   <= 1'b0;
            index_q <= index_q + 7'd1;
            under_q <= under_q | under;
            // Enters at column COLS - 1 and shifts towards column 0: after all columns each is in
            // place.
            over_q  <= (over_q >> 1) | ({{(OVER_BITS-1){1'b0}}, over} << (COLS - 1));
            ring_q  <= (ring_q >> CODE_BITS) | ({{((COLS-1)*CODE_BITS){1'b0}}, ring_word} << ((COLS - 1) * CODE_BITS));
            if (index_q == LAST_COLUMN[6:0]) begin
              phase_q <= OVERS;
              index_q <= 7'd0;
            end
          end
        end
        OVERS: begin
          index_q <= index_q + 7'd1;
          over_q  <= over_q >> 8;
          if (index_q == LAST_OVER[6:0]) begin
            phase_q <= last_i ? CRC : IDLE;
            index_q <= 7'd0;
          end
        end
        default: begin
          index_q <= 7'd1;
          if (index_q[0]) begin
            phase_q     <= IDLE;
            end_q       <= 1'b1;
            underflow_q <= under_q;
          end
        end
      endcase
    end

  assign count_shift_o  = taken;
  assign busy_o         = (phase_q != IDLE);
  assign frame_number_o = frame_number_q;
  assign begin_o        = row_valid_i & first_i;
  assign we_o           = busy_o;
  assign byte_o         = data;
  assign end_o          = end_q;
  assign underflow_o    = underflow_q;
  assign column_valid_o = taken;
  assign column_o       = index_q;
  assign column_count_o = count_i;
  assign column_slot_o  = slot_i;

endmodule

`default_nettype wire
