// SPDX-License-Identifier: Apache-2.0
// Techmap of the equivalence proof: state elements as black boxes with pins that describe them completely.
// Set and clear win: with either on, the data do not matter, and a set under a clear does not either.
// An opened latch with data is a set or a clear: whether a library's latch has its reset inside or in
// front of it is then the same.

(* blackbox *)
module cut_state (input up, input down, input clock, input set, input clear, output q);
endmodule

(* techmap_celltype = "$_DFFSR_PPP_" *)
module cut_flop (input C, input S, input R, input D, output Q);
  wire calm = ~S & ~R;
  cut_state _TECHMAP_REPLACE_ (.up(calm & D), .down(calm & ~D), .clock(C), .set(S & ~R), .clear(R), .q(Q));
endmodule

(* techmap_celltype = "$_DLATCHSR_PPP_" *)
module cut_latch (input E, input S, input R, input D, output Q);
  wire open = E & ~S & ~R;
  cut_state _TECHMAP_REPLACE_ (
    .up(1'b0), .down(1'b0), .clock(1'b0), .set(S & ~R | open & D), .clear(R | open & ~D), .q(Q)
  );
endmodule
