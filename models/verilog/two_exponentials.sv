// SPDX-License-Identifier: Apache-2.0
// Arithmetic of an output that is a sum of two exponentials, slow and fast, at constant current (integrator_piece.sv).
// Why a package: one copy of the functions instead of one per piece and column.
`default_nettype none

package two_exponentials;

  // Integral of exp(rate t) over 0..t.
  function automatic real grown(input real rate, input real t);
    /*verilator no_inline_task*/
    real u;
    u     = rate * t;
    // Below, the next term of the series is 4e-17; above, exp(u) - 1 keeps eleven digits.
    grown = (u < 1.0e-5 && u > -1.0e-5) ? t * (1.0 + u * (0.5 + u / 6.0)) : ($exp(u) - 1.0) / rate;
  endfunction

  // Output where its slope is 0: each exponential moves by its slope times the integral of exp(rate t).
  function automatic real at_turn(
    input real out, input real slow_slope, input real fast_slope, input real slow_rate, input real fast_rate
  );
    /*verilator no_inline_task*/
    real t;
    t       = $ln(-fast_slope / slow_slope) / (slow_rate - fast_rate);
    at_turn = out + slow_slope * grown(slow_rate, t) + fast_slope * grown(fast_rate, t);
  endfunction

  // Output at the end of a piece in which the charge stopped at a limit; excess is the charge above the limit without it.
  // From there the output follows a constant charge with time constant lag.
  function automatic real after_stop(
    input real limit, input real excess, input real slow, input real fast, input real current, input real length,
    input real slow_rate, input real fast_rate, input real slow_drive, input real fast_drive,
    input real slow_weight, input real fast_weight, input real lag
  );
    /*verilator no_inline_task*/
    integer n;
    real slow_t;
    real fast_t;
    real left;
    real right;
    real beyond_left;
    real beyond_right;
    real beyond;
    real t;
    left         = 0.0;
    right        = length;
    beyond_left  = slow_weight * slow + fast_weight * fast - limit;
    beyond_right = excess;
    beyond       = 1.0;
    t            = 0.0;
    slow_t       = slow;
    fast_t       = fast;
    if (beyond_left * beyond_right < 0.0) begin
      // The charge is nearly a straight line: the Illinois method converges in three to five steps.
      for (n = 0; n < 12; n = n + 1)
        // 1e-14 packet: the rounding of a charge of some packets.
        if (right > left && (beyond > 1.0e-14 || beyond < -1.0e-14)) begin
          t      = (left * beyond_right - right * beyond_left) / (beyond_right - beyond_left);
          slow_t = $exp(slow_rate * t) * slow + slow_drive * current * grown(slow_rate, t);
          fast_t = $exp(fast_rate * t) * fast + fast_drive * current * grown(fast_rate, t);
          beyond = slow_weight * slow_t + fast_weight * fast_t - limit;
          if (beyond * beyond_right > 0.0) begin
            right        = t;
            beyond_right = beyond;
            beyond_left  = 0.5 * beyond_left;
          end else begin
            left         = t;
            beyond_left  = beyond;
            beyond_right = 0.5 * beyond_right;
          end
        end
    end
    after_stop = limit + (slow_t + fast_t - limit) * $exp((t - length) / lag);
  endfunction

endpackage

`default_nettype wire
