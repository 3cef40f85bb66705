// SPDX-License-Identifier: Apache-2.0
// Analog half of the synchronized converter: integrator, comparator and charge source; the flip-flops are in rtl/.
// Interface: iin in i0, with VARIES its mean over the clock before the next edge; comp is the level at the next edge of
// clk_i; t_clocks counts from the end of preset.
// Effects: I_OFFSET, a constant current into the integrator.
`include "values.vh"
`default_nettype none

module vfc #(
  parameter EFFECTS    = 0,
  parameter VARIES     = 0,
  parameter SYNC_LATCH = 0
) (
  input  wire                         clk_i,
  input  real                         t_clocks,
  input  real                         iin,
  input  wire                         d_charge,
  input  wire                         d_preset,
  input  wire [64*`DERMIS_VALUES-1:0] values_i,
  output wire                         comp
);

  real i_sum;
  real i_low;
  real i_high;
  real i_a;
  real i_b;
  real i_c;
  real v_preset;
  real v_a;
  real v_b;
  real v_c;
  wire turns_a;
  wire turns_b;
  wire turns_c;
  real turn_a;
  real turn_b;
  real turn_c;

  generate
    if (EFFECTS[`DERMIS_I_OFFSET]) begin : gen_offset
      assign i_sum = iin + $bitstoreal(values_i[64*`DERMIS_I_OFFSET +: 64]);
    end else begin : gen_no_offset
      assign i_sum = iin;
    end
  endgenerate

  charge_source #(.EFFECTS(EFFECTS)) u_charge (.d_charge(d_charge), .values_i(values_i), .out(i_low));

  // Two flops switch the charge at rising edges. The latch switches it half way: its previous value comes first.
  generate
    if (SYNC_LATCH != 0) begin : gen_latch
      reg held_q;
      always @(posedge clk_i) held_q <= d_charge;
      charge_source #(.EFFECTS(EFFECTS)) u_held (.d_charge(held_q), .values_i(values_i), .out(i_high));
    end else begin : gen_flops
      assign i_high = i_low;
    end
    if ((SYNC_LATCH != 0) && EFFECTS[`DERMIS_DELAY]) begin : gen_either
      assign i_b = ($bitstoreal(values_i[64*`DERMIS_SEEN_B +: 64]) > 0.5) ? i_low : i_high;
    end else begin : gen_one
      assign i_b = i_low;
    end
  endgenerate
  assign i_a = i_high;
  assign i_c = i_low;

  integrator #(.EFFECTS(EFFECTS), .VARIES(VARIES), .SYNC_LATCH(SYNC_LATCH)) u_integrator (
    .clk_i      (clk_i),
    .t_clocks   (t_clocks),
    .iin        (i_sum),
    .icharge_a  (i_a),
    .icharge_b  (i_b),
    .icharge_c  (i_c),
    .d_preset   (d_preset),
    .values_i   (values_i),
    .out_preset (v_preset),
    .out_a      (v_a),
    .out_b      (v_b),
    .out_c      (v_c),
    .turns_a    (turns_a),
    .turns_b    (turns_b),
    .turns_c    (turns_c),
    .turn_a     (turn_a),
    .turn_b     (turn_b),
    .turn_c     (turn_c)
  );

  comparator #(.EFFECTS(EFFECTS), .SYNC_LATCH(SYNC_LATCH)) u_comparator (
    .clk_i     (clk_i),
    .in_preset (v_preset),
    .in_a      (v_a),
    .in_b      (v_b),
    .in_c      (v_c),
    .turns_a   (turns_a),
    .turns_b   (turns_b),
    .turns_c   (turns_c),
    .turn_a    (turn_a),
    .turn_b    (turn_b),
    .turn_c    (turn_c),
    .d_preset  (d_preset),
    .values_i  (values_i),
    .out       (comp)
  );

endmodule

`default_nettype wire
