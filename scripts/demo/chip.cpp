// SPDX-License-Identifier: Apache-2.0
// The chip in a browser: dermis_top as Verilator compiles it, the array, sixteen channels and a host on the SPI pins.
// Interface: JavaScript writes the arrays that the functions at the end return, calls run() and reads the results.
// The array is solved as dermis.array does, the channels follow engine event (dermis.engines.event), and the noise
// is that of dermis.converter.noise: the same numbers for the same seed, frame, row and column.
// The model is used without Verilator's simulator context, which needs threads and files.
#include <cmath>
#include <cstdint>

#include <wasm_simd128.h>

#include "Vtop___024root__0.cpp"
#include "Vtop___024root__0__Slow.cpp"
#include "Vtop___024root__Slow.cpp"
#include "Vtop__ConstPool__0__Slow.cpp"

void VL_FATAL_MT(const char*, int, const char*, const char*) VL_MT_SAFE { __builtin_trap(); }
WDataOutP VL_ZERO_RESET_W(int bits, WDataOutP out) VL_MT_SAFE {
    for (int word = 0; word < VL_WORDS_I(bits); ++word) out[word] = 0;
    return out;
}

namespace {

static_assert(COLS % 2 == 0 && COLS <= 32 && ROWS <= 32, "columns go by pairs; lines are bits of a word");

constexpr int CELLS = ROWS * COLS;
constexpr int FRAMES_KEPT = 4;   // a frame is read while the next one is scanned
constexpr int ANSWER_MAX = 512 + ROWS * (1 + COLS * 2 + (COLS + 7) / 8);  // token, length and frame (docs/spi.md)
constexpr int TRACE = 3 * SLOT_CLOCKS;

// Settings, in the order in which the page writes them.
enum Setting { V_BIAS, UNIT_A, R_ROW, R_COLUMN, G_LATERAL, COMP_NOISE, FLICKER, SEED, SETTINGS };
double settings[SETTINGS];
double gain[COLS], offset_v[COLS], resistance_ohm[CELLS];

double duty[FRAMES_KEPT][CELLS], packet[FRAMES_KEPT][CELLS];
uint64_t keys[CELLS];

// ---- the array -----------------------------------------------------------------------------------------------

double current_a[CELLS];

// Column currents for every driven row: row lines are eliminated, the columns are one symmetric matrix.
void solve(const double* g, double v_bias) {
    const double r = settings[R_ROW], rc = settings[R_COLUMN], lateral = ROWS * settings[G_LATERAL];
    static double row_sum[ROWS], factor[COLS][COLS], pivot[COLS], u[COLS];
    for (int q = 0; q < ROWS; ++q) {
        row_sum[q] = 0;
        for (int c = 0; c < COLS; ++c) row_sum[q] += g[q * COLS + c];
    }
    if (rc > 0) {
        for (int c = 0; c < COLS; ++c) {
            for (int d = 0; d <= c; ++d) {
                double sum = 0;
                if (c == d) {
                    sum = 1 / rc + lateral * ((c > 0) + (c < COLS - 1));
                    for (int q = 0; q < ROWS; ++q) {
                        double own = g[q * COLS + c];
                        sum += own * (1 + r * (row_sum[q] - own)) / (1 + r * row_sum[q]);
                    }
                } else {
                    sum = c - d == 1 ? -lateral : 0;
                    for (int q = 0; q < ROWS; ++q)
                        sum -= g[q * COLS + c] * g[q * COLS + d] * r / (1 + r * row_sum[q]);
                }
                for (int e = 0; e < d; ++e) sum -= factor[c][e] * factor[d][e] * pivot[e];
                if (c == d) pivot[c] = sum;
                else factor[c][d] = sum / pivot[d];
            }
        }
    }
    for (int driven = 0; driven < ROWS; ++driven) {
        const double* row = g + driven * COLS;
        for (int c = 0; c < COLS; ++c) u[c] = offset_v[c];
        if (rc > 0) {
            for (int c = 0; c < COLS; ++c) {
                u[c] = row[c] * v_bias / (1 + r * row_sum[driven]) + offset_v[c] / rc;
                for (int d = 0; d < c; ++d) u[c] -= factor[c][d] * u[d];
            }
            for (int c = 0; c < COLS; ++c) u[c] /= pivot[c];
            for (int c = COLS - 1; c >= 0; --c)
                for (int d = 0; d < c; ++d) u[d] -= factor[c][d] * u[c];
        }
        double* out = current_a + driven * COLS;
        for (int c = 0; c < COLS; ++c) out[c] = 0;
        for (int q = 0; q < ROWS; ++q) {
            double fed = q == driven ? v_bias : 0;
            for (int c = 0; c < COLS; ++c) fed += r * g[q * COLS + c] * u[c];
            fed /= 1 + r * row_sum[q];
            for (int c = 0; c < COLS; ++c) out[c] += g[q * COLS + c] * (fed - u[c]);
        }
        for (int c = 0; c + 1 < COLS; ++c) {
            double across = lateral * (u[c + 1] - u[c]);
            out[c] += across;
            out[c + 1] -= across;
        }
    }
}

// ---- noise: dermis.converter.noise ------------------------------------------------------------------------------

constexpr uint64_t WEYL = 0x9E3779B97F4A7C15u, MIX1 = 0xBF58476D1CE4E5B9u, MIX2 = 0x94D049BB133111EBu;
enum Stream { STREAM_FLICKER = 2, STREAM_LEVEL = 4 };

uint64_t mix(uint64_t z) {
    z = (z ^ (z >> 30)) * MIX1;
    z = (z ^ (z >> 27)) * MIX2;
    return z ^ (z >> 31);
}

double polynomial(const double* of, double r) {
    double value = of[0];
    for (int i = 1; i < 8; ++i) value = value * r + of[i];
    return value;
}

// Inverse of the normal distribution (Wichura, AS241): numerators and denominators of the middle, beyond and far out,
// coefficients from the highest power.
double inverse_normal(double p) {
    static const double of[3][2][8] = {
        {{2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4, 4.5921953931549871457e4,
          1.3731693765509461125e4, 1.9715909503065514427e3, 1.3314166789178437745e2, 3.3871328727963666080e0},
         {5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4, 2.1213794301586595867e4,
          5.3941960214247511077e3, 6.8718700749205790830e2, 4.2313330701600911252e1, 1.0}},
        {{7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1, 1.27045825245236838258e0,
          3.64784832476320460504e0, 5.76949722146069140550e0, 4.63033784615654529590e0, 1.42343711074968357734e0},
         {1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2, 1.48103976427480074590e-1,
          6.89767334985100004550e-1, 1.67638483018380384940e0, 2.05319162663775882187e0, 1.0}},
        {{2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3, 2.65321895265761230930e-2,
          2.96560571828504891230e-1, 1.78482653991729133580e0, 5.46378491116411436990e0, 6.65790464350110377720e0},
         {2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5, 7.86869131145613259100e-4,
          1.48753612908506148525e-2, 1.36929880922735805310e-1, 5.99832206555887937690e-1, 1.0}},
    };
    double q = p - 0.5;
    bool middle = std::fabs(q) <= 0.425;
    double r = middle ? 0.180625 - q * q : std::sqrt(-std::log(q < 0 ? p : 1.0 - p));
    const auto& part = of[middle ? 0 : r <= 5.0 ? 1 : 2];
    if (!middle) r -= r <= 5.0 ? 1.6 : 5.0;
    double over = polynomial(part[0], r), under = polynomial(part[1], r);
    return (middle ? q * over : q < 0 ? -over : over) / under;
}

double normal(uint64_t key, uint64_t stream, uint64_t counter) {
    uint64_t begin = mix(key ^ (stream * MIX2));
    return inverse_normal((double(mix(begin + counter * WEYL) >> 11) + 0.5) * 0x1p-53);
}

// ---- a frame begins ---------------------------------------------------------------------------------------------

int frames_begun;

void begin_frame() {
    static double g[CELLS];
    for (int i = 0; i < CELLS; ++i) g[i] = 1 / resistance_ohm[i];
    solve(g, settings[V_BIAS]);
    int place = frames_begun % FRAMES_KEPT;
    uint64_t of_frame = mix(mix(uint64_t(settings[SEED]) * MIX1 + WEYL) + uint64_t(frames_begun) * WEYL);
    for (int r = 0; r < ROWS; ++r) {
        uint64_t of_row = mix(of_frame + uint64_t(r + 1) * MIX2);
        for (int c = 0; c < COLS; ++c) {
            int i = r * COLS + c;
            keys[i] = mix(of_row + uint64_t(c + 1) * WEYL);
            duty[place][i] = gain[c] * current_a[i] / settings[UNIT_A];
            packet[place][i] =
                settings[FLICKER] > 0 ? 1.0 + settings[FLICKER] * normal(keys[i], STREAM_FLICKER, 0) : 1.0;
        }
    }
    ++frames_begun;
}

// ---- chip, channels and host, clock by clock ----------------------------------------------------------------------

Vtop___024root* top;
bool ready;

double x[COLS], level[COLS], packets[COLS];
int ones[COLS];
int decision;  // of the gate, from 1; it stays 1 while the preset is on
int row;       // driven, or -1

uint8_t answer[ANSWER_MAX];
int answer_bytes, answers;
uint8_t command, shifted;
int bits, state, left;
enum { COMMAND, WAIT, LENGTH_HIGH, LENGTH_LOW, DATA, END };

float trace_v[TRACE][COLS];
uint32_t trace_comp[TRACE], trace_charge[TRACE];
uint8_t trace_row[TRACE], trace_preset[TRACE];
unsigned clocks;

void load_row() {
    row = -1;
    for (int r = 0; r < ROWS; ++r)
        if (top->row_select_o >> r & 1) row = r;
    if (row == 0) begin_frame();
    int place = (frames_begun + FRAMES_KEPT - 1) % FRAMES_KEPT;
    for (int c = 0; c < COLS; ++c) {
        x[c] = row < 0 ? 0 : duty[place][row * COLS + c];
        packets[c] = row < 0 ? 1 : packet[place][row * COLS + c];
    }
}

unsigned compare() {
    unsigned comp = 0;
    const double n = decision;
    const v128_t times = wasm_f64x2_splat(n);
    for (int c = 0; c < COLS; c += 2) {
        v128_t gathered = wasm_f64x2_mul(times, wasm_v128_load(x + c));
        comp |= unsigned(wasm_i64x2_bitmask(wasm_f64x2_ge(gathered, wasm_v128_load(level + c)))) << c;
    }
    if (settings[COMP_NOISE] > 0 && row >= 0) {
        const double sigma = settings[COMP_NOISE];
        for (int c = 0; c < COLS; ++c) {
            double above = n * x[c] - level[c];
            if (std::fabs(above) > 8 * sigma) continue;
            bool high = above + sigma * normal(keys[row * COLS + c], STREAM_LEVEL, uint64_t(decision)) >= 0;
            comp = (comp & ~(1u << c)) | unsigned(high) << c;
        }
    }
    return comp;
}

// The host fetches every frame as soon as there is one; SCK runs at half of the chip's clock.
void host() {
    if (top->spi_cs_ni) {
        if (!top->frame_ready_o) return;
        top->spi_cs_ni = 0;
        command = 0x0B;
        top->spi_copi_i = command >> 7;
        bits = state = answer_bytes = 0;
        return;
    }
    if (top->spi_sck_i) {
        top->spi_sck_i = 0;
        command = uint8_t(command << 1);
        top->spi_copi_i = command >> 7;
        return;
    }
    if (state == END) {
        top->spi_cs_ni = 1;
        ++answers;
        return;
    }
    top->spi_sck_i = 1;
    shifted = uint8_t(shifted << 1 | top->spi_cipo_o);
    if (++bits & 7) return;
    bool first = state == WAIT;
    if (state == COMMAND) {
        state = WAIT;
        return;
    }
    if (first && shifted == 0) return;
    if (answer_bytes < ANSWER_MAX) answer[answer_bytes++] = shifted;
    if (first) state = shifted == 0x3C ? LENGTH_HIGH : END;
    else if (state == LENGTH_HIGH) left = shifted << 8, state = LENGTH_LOW;
    else if (state == LENGTH_LOW) left |= shifted, state = left ? DATA : END;
    else if (--left == 0) state = END;
}

template <bool TRACED>
void clock() {
    unsigned charge = top->charge_o, preset = top->preset_o;
    for (unsigned some = charge; some; some &= some - 1) {
        int c = __builtin_ctz(some);
        level[c] = 0.5 + ++ones[c] * packets[c];
    }
    unsigned comp = TRACED || !preset ? compare() : 0;  // the preset inhibits what the comparators say
    if (TRACED) {
        unsigned at = clocks % TRACE;
        for (int c = 0; c < COLS; ++c) trace_v[at][c] = float(decision * x[c] - level[c]);
        trace_comp[at] = comp;
        trace_charge[at] = charge;
        trace_row[at] = uint8_t(row);
        trace_preset[at] = uint8_t(preset);
    }
    top->comp_async_i = comp;
    top->row_sense_i = top->row_select_o;
    unsigned selected = top->row_select_o;
    host();
    // One evaluation a clock: no register moves at the falling edge, so it is left out.
    top->clk_i = 1;
    top->__Vtrigprevexpr___TOP__clk_i__0 = 0;
    Vtop___024root___eval(top);
    ++clocks;
    if (preset) {
        decision = 1;
        for (int c = 0; c < COLS; ++c) ones[c] = 0, level[c] = 0.5;
    } else ++decision;
    if (top->row_select_o != selected) load_row();
}

}  // namespace

#define EXPORT(name) extern "C" __attribute__((export_name(#name)))

EXPORT(settings) double* at_settings() { return settings; }
EXPORT(gain) double* at_gain() { return gain; }
EXPORT(offset_v) double* at_offset() { return offset_v; }
EXPORT(resistance_ohm) double* at_resistance() { return resistance_ohm; }
EXPORT(answer) uint8_t* at_answer() { return answer; }
EXPORT(answer_bytes) int get_answer_bytes() { return answer_bytes; }
EXPORT(trace_v) float* at_trace_v() { return &trace_v[0][0]; }
EXPORT(trace_comp) uint32_t* at_trace_comp() { return trace_comp; }
EXPORT(trace_charge) uint32_t* at_trace_charge() { return trace_charge; }
EXPORT(trace_row) uint8_t* at_trace_row() { return trace_row; }
EXPORT(trace_preset) uint8_t* at_trace_preset() { return trace_preset; }
EXPORT(trace_length) int get_trace_length() { return TRACE; }
EXPORT(clocks) unsigned get_clocks() { return clocks; }
EXPORT(row) int get_row() { return row; }
EXPORT(decision) int get_decision() { return decision; }

// Duties and packets of the frame that the chip numbered `number`, one of the last FRAMES_KEPT - 1.
EXPORT(duty) double* at_duty(int number) { return duty[(number - 1) & (FRAMES_KEPT - 1)]; }
EXPORT(packet) double* at_packet(int number) { return packet[(number - 1) & (FRAMES_KEPT - 1)]; }

// Reset the chip and release it: the next frame is the first.
EXPORT(reset) void reset() {
    if (!ready) {
        top = new Vtop___024root(nullptr, "top");
        Vtop___024root___eval_static(top);
        Vtop___024root___eval_initial(top);
        Vtop___024root___eval_settle(top);
        ready = true;
    }
    frames_begun = answers = answer_bytes = 0;
    row = -1;
    decision = 1;
    for (int c = 0; c < COLS; ++c) x[c] = 0, packets[c] = 1, ones[c] = 0, level[c] = 0.5;
    top->rst_ni = 1;
    top->enable_i = 0;
    top->spi_cs_ni = 1;
    top->spi_sck_i = top->spi_copi_i = 0;
    clock<false>();
    top->rst_ni = 0;
    clock<false>();
    top->rst_ni = 1;
    top->enable_i = 1;
}

// Run up to `most` clocks, less where a frame was read (returns 1) or has begun (returns 2); 0 after all of them.
EXPORT(run) int run(int most, int traced) {
    int before = answers, begun = frames_begun;
    while (most-- > 0) {
        if (traced) clock<true>();
        else clock<false>();
        if (answers != before) return 1;
        if (frames_begun != begun) return 2;
    }
    return 0;
}

// What the taxels conduct by themselves, of measured duties in `measured`: every sweep corrects each conductance by the
// current that the modelled array misses (dermis.decode). Conductances in siemens replace the duties.
double measured[CELLS];
EXPORT(measured) double* at_measured() { return measured; }
EXPORT(correct) void correct(int sweeps) {
    static double g[CELLS], rest[CELLS];
    const double v = settings[V_BIAS];
    for (int i = 0; i < CELLS; ++i) {
        measured[i] *= settings[UNIT_A] / gain[i % COLS];
        g[i] = measured[i] / v;
    }
    while (sweeps-- > 0) {
        solve(g, 0);
        for (int i = 0; i < CELLS; ++i) rest[i] = current_a[i];
        solve(g, v);
        for (int i = 0; i < CELLS; ++i) {
            double follows = current_a[i] - rest[i], each = follows > 0 ? g[i] / follows : 0;
            double wanted = g[i] + (measured[i] - current_a[i]) * (each > 1 / v ? each : 1 / v);
            // A code of 0 says no more than that the current is below half a count, or negative: open fits it.
            g[i] = wanted > 0 && measured[i] > 0 ? wanted : 0;
        }
    }
    for (int i = 0; i < CELLS; ++i) measured[i] = g[i];
}
