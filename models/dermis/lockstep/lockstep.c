/* SPDX-License-Identifier: Apache-2.0
 *
 * Drives one ngspice transient in exact lock-step with a caller that knows every digital edge in advance.
 *
 * ngspice runs as a coroutine on a stack of its own: lockstep_advance() enters it, the synchronisation callback
 * leaves it again once a time point stands at the requested time. One thread, so a hand-over costs a
 * context switch in user space instead of two wake-ups of the scheduler, and Python is never called back.
 *
 * Edges are exact because the digital source is a function of time (a ramp from t to t + t_edge), and because
 * every corner of that function is a time point of the solution. Between corners the sources are
 * straight lines, which trapezoidal integration of a capacitor follows without error.
 */
#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <ucontext.h>

#include <ngspice/sharedspice.h>

#define STACK_BYTES (64u << 20) /* ngspice's parser recurses deeply on large decks; pages are only touched when used */
#define MAX_SOURCES 1024 /* a 256 x 256 array has 513 */
#define MAX_EDGES (4 * MAX_SOURCES)

/* What `lockstep_open` takes, and from t_now and started on what it tells; ngspice.py has the same fields, and Deck there
   says what they mean. It stays until the next one. said: all text from ngspice. record: rows of a time and all probes. */
struct circuit {
    const char *log_path, **source_names, **probe_names;
    const double *levels, *t_edges, *late;
    const int *abrupt;
    double t_edge, t_max_step, t_stop, growth, t_now;
    int n_source, n_probe, recording, use_ic, own_steps;

    int started; /* the operating point stands: what ngspice says of time is time of the transient */
    long accepted, rejected, loads;
    char *said, *record;
    size_t said_bytes, record_bytes;
    char error[256];
};

/* FAILED: the circuit cannot go on, but there may be another */
enum state { CLOSED, READY, RUNNING, ENDED, FAILED };

struct source {
    const char *key;    /* the name in ngspice */
    int next;           /* the source that it asked for after this one */
    double from, to, t, t_edge; /* level before and after the edge that starts at t and lasts t_edge */
    bool asked;         /* ngspice has it as an external source */
};

static struct circuit *of;
static struct lockstep {
    enum state state;
    FILE *log, *said, *record;

    struct source source[MAX_SOURCES];
    int last; /* that ngspice asked for */

    int vector[MAX_SOURCES]; /* of each probe, in ngspice */
    double probe[MAX_SOURCES], due[MAX_SOURCES]; /* and the time of its next sample */
    double *samples, *low, *high; /* of the last advance, the extremes since it began */

    bool poisoned; /* sources are NaN, so that ngspice gives up */
    bool waiting;  /* ngspice is in a transient and its caller has control */

    double t_target, t_corner; /* time of the last corner of a source */

    /* the step that was accepted last time, by what it follows: a sample without an edge, a ramp start, a ramp end */
    double remembered[3];
    enum { AFTER_SAMPLE, AT_RAMP, AFTER_RAMP } kind;
    bool first_of_kind;
    bool met, ramp_begins; /* this time point is a sample, and the caller began an edge there */
} ls;
static ucontext_t caller, runner;
static bool gone; /* ngspice wished to end the process, and takes no other circuit */

/* ---- failures and text from ngspice ----------------------------------------------------------------------- */

/* The first one is told. */
static int fail(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    if (ls.state != FAILED)
        vsnprintf(of->error, sizeof of->error, format, values);
    va_end(values);
    ls.state = FAILED;
    return -1;
}

static int on_char(char *text, int id, void *user)
{
    (void)id, (void)user;
    fprintf(ls.log, "%s\n", text);
    fprintf(ls.said, "%s\n", text);
    return fflush(ls.said);
}

static int on_exit_wish(int status, NG_BOOL immediate, NG_BOOL quit, int id, void *user)
{
    (void)immediate, (void)quit, (void)id, (void)user;
    gone = true;
    return fail("ngspice gave up (status %d)", status);
}

/* ---- sources ---------------------------------------------------------------------------------------------- */

/* ngspice asks for all sources in the same order again and again, by the addresses of its own names. */
static int source_index(const char *name)
{
    int i = ls.source[ls.last].next;
    if (ls.source[i].key != name) {
        for (i = 0; i < of->n_source && strcasecmp(of->source_names[i], name); i++)
            ;
        if (i == of->n_source)
            return -1;
        ls.source[ls.last].next = i, ls.source[i].key = name;
    }
    return ls.last = i;
}

static double level(const struct source *s, double t)
{
    if (t <= s->t)
        return s->from;
    if (t >= s->t + s->t_edge)
        return s->to;
    return s->from + (s->to - s->from) * ((t - s->t) / s->t_edge);
}

static int on_source(double *value, double t, char *name, int id, void *user)
{
    (void)id, (void)user;
    int i = source_index(name);
    if (i < 0) /* nobody would ever drive it */
        fail("the netlist has an external source %.60s that nothing drives", name);
    else
        ls.source[i].asked = true;
    /* the hidden transient by which ngspice may look for an operating point has a time of its own */
    *value = i < 0 ? 0.0 : level(&ls.source[i], of->started ? t : 0.0);
    if (!isfinite(*value))
        fail("source %.60s is %g at %g s", name, *value, t);
    if (ls.poisoned || ls.state == FAILED) /* it would go on to its end alone */
        *value = NAN;
    of->loads += i == 0; /* it asks for all alike */
    return 0;
}

/* ---- time ------------------------------------------------------------------------------------------------- */

/* times this close are one: four operations on a time each round it by half an ulp; ngspice takes 100 ulp as one */
static double ulps(double t) { return 8.0 * 2.220446049250313e-16 * fmax(fabs(t), 1e-12); }

/* Times this close are one: a step between them would be near ngspice's smallest, 1e-11 of the largest. */
static double tiny(void) { return 1e-10 * of->t_max_step; }

/* The first time after t of a sample, or at which a source begins or ends its edge, and if one does at t: no step goes
   beyond it. */
static double next_corner(double t, bool *landed)
{
    double next = ls.t_target;
    for (int p = 0; p < of->n_probe; p++)
        if (ls.due[p] > t + ulps(t))
            next = fmin(next, ls.due[p]);
    for (const struct source *s = ls.source; s < ls.source + of->n_source; s++)
        for (int end = 0; end < 2; end++) {
            double corner = end ? s->t + s->t_edge : s->t;
            if (corner > t + ulps(t))
                next = fmin(next, corner);
            else if (corner >= t - ulps(t))
                *landed = true;
        }
    return next;
}

/* Hand over to the caller if a time point stands at the time it asked for, and learn its next edges.

   Done as soon as the point is accepted, before ngspice looks whether it stands on a breakpoint, because behind a switched
   conductance the integration must start anew with backward Euler: at the edge, so that the integral does not begin half
   a ramp late, and at the end of its ramp, because the current that charged a capacitor through the closing
   switch would go on in the trapezoidal rule with alternating sign for ever. */
static void meet(double t)
{
    of->t_now = t;
    while (t >= ls.t_target - ulps(t)) {
        ls.ramp_begins = false;
        ls.waiting = true;
        swapcontext(&runner, &caller);
        ls.waiting = false;
        if (ls.poisoned)
            return;
        ls.met = true;
        for (int i = 0; i < of->n_source; i++)
            if (of->abrupt[i] && ls.source[i].t >= t - ulps(t)) {
                /* ngspice ignores a breakpoint at its own time, and takes one within 100 ulp as reached */
                ngSpice_SetBkpt(ls.source[i].t + 2.0 * ulps(t));
                ngSpice_SetBkpt(ls.source[i].t + ls.source[i].t_edge);
            }
    }
}

static int on_sync(double t, double *delta, double old_delta, int redo, int id, int where, void *user)
{
    (void)old_delta, (void)id, (void)user;
    if (ls.state != RUNNING || !of->started || ls.poisoned) /* a hidden transient: its points are nobody's samples */
        return 0;
    if (where != 0) {
        if (redo) {
            of->rejected++;
            if (ls.first_of_kind && ls.remembered[ls.kind] > *delta)
                ls.remembered[ls.kind] = *delta;
        }
        return 0;
    }
    of->accepted++;
    meet(t); /* without initial operating point there is no data at t = 0 */
    bool landed = false;
    double left = next_corner(t, &landed) - t;
    if (landed)
        ls.kind = AFTER_RAMP;
    if (ls.met) {
        if (ls.ramp_begins)
            ls.kind = AT_RAMP;
        else if (!landed)
            ls.kind = AFTER_SAMPLE;
        landed = true;
        ls.met = false;
    }
    ls.first_of_kind = landed;
    if (landed && ls.kind != AFTER_SAMPLE)
        ls.t_corner = t;
    if (landed && !of->own_steps) {
        /* ngspice at most doubles a step, so after a ramp of 1 ns it would need eight steps for a clock period;
           start instead with what was accepted at the same place last time, and let it be a little bolder.
           Gear's formula, which looks back two steps, is unstable where a step is more than 1 + sqrt(2) times
           the last. */
        *delta = fmax(*delta, fmin(1.5 * ls.remembered[ls.kind], of->t_max_step));
    }
    if (of->growth > 0.0) /* transistors switch behind an edge: truncation control alone let a packet be 0.4 % off */
    {
        double since = t - ls.t_corner; /* twice the share at twenty edges, when what switches has switched */
        *delta = fmin(*delta, of->growth * fmax(0.8 * of->t_edge, since + since * since / (20.0 * of->t_edge)));
    }
    if (of->accepted < 4) /* ngspice starts with backward Euler; be past it before the first edge */
        *delta = fmin(*delta, 0.2 * left);
    /* a step that misses the corner by rounding would be halved for ever */
    if (*delta > left - (of->own_steps ? tiny() : 1e-3 * left))
        *delta = left;
    else if (1.9 * *delta > left)
        *delta = 0.5 * left;
    if (landed)
        ls.remembered[ls.kind] = *delta;
    return 0;
}

/* ---- data ------------------------------------------------------------------------------------------------- */

static int on_init_data(pvecinfoall all, int id, void *user)
{
    (void)id, (void)user;
    for (int p = 0; p < of->n_probe; p++) {
        ls.vector[p] = -1;
        for (int v = 0; v < all->veccount; v++)
            if (!strcasecmp(all->vecs[v]->vecname, of->probe_names[p]))
                ls.vector[p] = v;
    }
    return 0;
}

static int on_data(pvecvaluesall all, int count, int id, void *user)
{
    (void)count, (void)id, (void)user;
    double t = 0.0;
    if (ls.state != RUNNING || ls.poisoned)
        return 0;
    of->started = true;
    for (int v = 0; v < all->veccount; v++)
        if (all->vecsa[v]->is_scale)
            t = all->vecsa[v]->creal;
    for (int p = 0; p < of->n_probe; p++) {
        if (ls.vector[p] >= 0)
            ls.probe[p] = all->vecsa[ls.vector[p]]->creal;
        if (fabs(t - ls.due[p]) <= ulps(t))
            ls.samples[p] = ls.probe[p], ls.met = true, ls.ramp_begins = false;
        ls.low[p] = fmin(ls.low[p], ls.probe[p]), ls.high[p] = fmax(ls.high[p], ls.probe[p]);
    }
    if (ls.record) {
        fwrite_unlocked(&t, sizeof t, 1, ls.record);
        fwrite_unlocked(ls.probe, sizeof t, (size_t)of->n_probe, ls.record);
        if (fflush(ls.record))
            abort();
    }
    meet(t);
    return 0;
}

/* ---- the coroutine ---------------------------------------------------------------------------------------- */

static void run(void)
{
    char command[128];
    /* a step further: ngspice 39 ends 1e-11 of a step before its last time, 46 earlier */
    snprintf(command, sizeof command, "tran %.17g %.17g 0 %.17g%s", of->t_edge, of->t_stop + of->t_max_step,
             of->t_max_step, of->use_ic ? " uic" : "");
    if (ngSpice_Command(command))
        fail("ngspice stopped");
    else if (ls.state == RUNNING)
        ls.state = ENDED;
    swapcontext(&runner, &caller);
}

/* The circuit was loaded and ngspice has no solution: -2, and the process can have another circuit; -1 if it cannot. */
static int give_up(const char *what)
{
    if (ls.waiting) { /* with sources that are no number it returns by itself: its smallest step does not converge */
        ls.state = RUNNING, ls.poisoned = true;
        swapcontext(&caller, &runner);
    }
    bool returned = ls.state == ENDED;
    fail("%s", what);
    return returned ? -2 : -1;
}

/* ---- the interface ---------------------------------------------------------------------------------------- */

/* Make ready for a circuit, which the caller loads then. */
int lockstep_open(struct circuit *next)
{
    static void *stack;
    static int ident;
    const char *refusal = NULL;
    if (ls.state == RUNNING)
        refusal = "this process has another circuit that did not come to its end";
    else if (ls.waiting) /* the last circuit failed */
        give_up("the transient was given up");
    if (!refusal && (ls.waiting || gone))
        refusal = "ngspice takes no other circuit in this process";
    else if (next->n_source > MAX_SOURCES || next->n_probe > MAX_SOURCES)
        refusal = "too many sources or probes";
    if (refusal) {
        ls.state = FAILED;
        snprintf(next->error, sizeof next->error, "%s", refusal);
        return -1;
    }
    if (of) {
        if (ls.log)
            fclose(ls.log);
        if (ls.record)
            fclose(ls.record);
        fclose(ls.said);
        free(of->said), free(of->record);
        of->said = of->record = NULL, of->said_bytes = of->record_bytes = 0;
    }
    memset(&ls, 0, sizeof ls); /* a null pointer is all zeros, and so are CLOSED, AFTER_SAMPLE and false */
    of = next, of->started = of->use_ic;
    ls.said = open_memstream(&of->said, &of->said_bytes);
    ls.record = of->recording ? open_memstream(&of->record, &of->record_bytes) : NULL;
    if (!(ls.log = fopen(of->log_path, "a")))
        return fail("cannot write the log");
    for (int i = 0; i < of->n_source; i++)
        ls.source[i] = (struct source){.from = of->levels[i], .to = of->levels[i], .t = -HUGE_VAL,
                                       .t_edge = of->t_edges[i]};
    for (int p = 0; p < of->n_probe; p++)
        ls.vector[p] = -1, ls.probe[p] = NAN;
    for (int k = 0; k < 3; k++)
        ls.remembered[k] = of->t_max_step;
    if (!stack) {
        stack = mmap(NULL, STACK_BYTES, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
        if (stack == MAP_FAILED || ngSpice_Init(on_char, NULL, on_exit_wish, on_data, on_init_data, NULL, NULL))
            return fail("ngspice does not start");
        ngSpice_Init_Sync(on_source, NULL, on_sync, &ident, NULL);
        /* Debian's library evaluates transistors in two threads of OpenMP, which wait for each other by spinning: with more
           processes than cores an iteration of one channel took 3 ms instead of 0.1 ms */
        ngSpice_Command("set num_threads=1");
    } else {
        ngSpice_Command("destroy all");
        ngSpice_Command("remcirc");
        ngSpice_Command("unset cshunt_value"); /* where ngspice keeps .options cshunt, over the end of its circuit */
    }
    getcontext(&runner);
    runner.uc_stack.ss_sp = stack, runner.uc_stack.ss_size = STACK_BYTES, runner.uc_link = &caller;
    makecontext(&runner, run, 0);
    ls.state = READY;
    return 0;
}

/* A name that the circuit does not have: -3. A probe is looked up when ngspice begins, before it has a solution; every source
   is asked for by the first one. */
static int wrong_name(const char *name) { return fail("%s", name), -3; }

/* Let ngspice run to a time. */
static int run_to(double to)
{
    ls.t_target = to, ls.state = RUNNING;
    swapcontext(&caller, &runner);
    if (ls.state == FAILED)
        return -1;
    for (int p = 0; p < of->n_probe; p++)
        if (ls.vector[p] < 0)
            return wrong_name(of->probe_names[p]);
    if (of->t_now < to - ulps(to) || !of->started)
        return give_up(of->started ? "ngspice stopped" : "ngspice found no operating point");
    for (int i = 0; i < of->n_source; i++)
        if (!ls.source[i].asked)
            return wrong_name(of->source_names[i]);
    for (int p = 0; p < of->n_probe && (to > 0.0 || !of->use_ic); p++) /* else there is no sample yet */
        if (!isfinite(ls.probe[p])) {
            char what[128];
            snprintf(what, sizeof what, "a sample is no number: node \"%.63s\" is %g", of->probe_names[p], ls.probe[p]);
            return give_up(what);
        }
    return 0;
}

/* Solve up to time `to`; edge i moves source edge_source[i] to edge_level[i], beginning at edge_time[i] in [now, to].
   samples receives the probes at `to`, late ones as they were that much earlier, at `to` for a time before 0; low and high
   their extremes over all time points since the last call. */
int lockstep_advance(double to, int n_edge, const int *edge_source, const double *edge_time, const double *edge_level,
                     double *samples, double *low, double *high)
{
    static int order[MAX_EDGES];
    int failed = 0;
    if (ls.state != READY && ls.state != RUNNING)
        return fail(ls.state == ENDED ? "the transient has ended" : "the circuit is not running");
    if (to > of->t_stop * (1.0 + 1e-12)) /* clocks times period may round beyond frames times slot */
        return fail("asked to go beyond the end of the transient");
    if (n_edge > MAX_EDGES)
        return fail("more than %d edges", MAX_EDGES);
    ls.samples = samples, ls.low = low, ls.high = high;
    for (int p = 0; p < of->n_probe; p++) {
        double now = of->t_now, at = to - of->late[p];
        if (at < now - tiny() && now > 0.0)
            return fail("not advanced: a probe is %g s late, but the last sample is %g s ago", of->late[p], to - now);
        ls.due[p] = at < 0.0 || at > to - tiny() ? to : at < now + tiny() ? now : at;
        samples[p] = ls.probe[p], low[p] = HUGE_VAL, high[p] = -HUGE_VAL;
    }
    for (int e = 0; e < n_edge; e++) { /* in order of time: nearly always they are */
        int k = e;
        for (; k > 0 && edge_time[order[k - 1]] > edge_time[e]; k--)
            order[k] = order[k - 1];
        order[k] = e;
    }
    for (int k = 0; k < n_edge; k++) {
        int e = order[k], i = edge_source[e];
        double t = edge_time[e];
        if (i < 0 || i >= of->n_source || !(t >= of->t_now - ulps(t) && t <= to)) /* nor NaN */
            return fail("an edge lies outside the interval, or is of no source");
        struct source *s = &ls.source[i];
        if (t < s->t + s->t_edge - ulps(t))
            return fail("an edge begins before the last one of its source has ended: %.60s at %.9g s",
                        of->source_names[i], t);
        if (s->t + s->t_edge > of->t_now && (failed = run_to(t))) /* a source has one edge at a time */
            return failed;
        s->from = level(s, t), s->to = edge_level[e], s->t = t;
        ls.ramp_begins = true;
    }
    return run_to(to);
}

/* Let a transient return, at its end or given up before, so that the process can have another circuit. */
void lockstep_close(void)
{
    if (ls.state == RUNNING && of->t_now < of->t_stop - 1e-10 * of->t_max_step)
        give_up("the transient was ended");
    else if (ls.state == RUNNING) {
        ls.t_target = HUGE_VAL;
        swapcontext(&caller, &runner);
    }
}
