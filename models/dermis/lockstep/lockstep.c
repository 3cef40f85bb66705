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
#define MAX_CORNERS (2 * MAX_SOURCES + 8)
#define TEXT_BYTES 4096

/* ABORTED: ngspice gave the transient up and has returned; FAILED: the circuit cannot go on, but there may be another */
enum state { CLOSED, READY, RUNNING, ENDED, ABORTED, FAILED };

struct source {
    char name[64];
    const char *key;    /* the name in ngspice */
    int next;           /* the source that it asked for after this one */
    double from, to, t; /* level before and after the edge that starts at t */
    double t_edge;      /* how long its edges last */
    bool asked;         /* ngspice has it as an external source */
    bool abrupt;        /* its edge switches a conductance: integration restarts with backward Euler behind it */
};

static struct lockstep {
    enum state state;
    ucontext_t caller, runner;
    void *stack;
    char command[256];

    struct source source[MAX_SOURCES];
    int n_source, last; /* that ngspice asked for */

    char probe_name[MAX_SOURCES][64];
    int probe_vector[MAX_SOURCES], n_probe;
    double probe[MAX_SOURCES];
    double low[MAX_SOURCES], high[MAX_SOURCES]; /* of each probe since the last advance began */
    double late[MAX_SOURCES], delay[MAX_SOURCES]; /* by probe, and the different ones of these, longest first */
    int n_delay;

    double corner[MAX_CORNERS]; /* ascending; times at which some source changes its slope */
    int n_corner;

    bool started; /* the operating point stands: what ngspice says of time is time of the transient */
    bool sampled; /* the probes have had a value; with initial conditions there is none at time 0 */
    bool loading, refused; /* the deck is being read, and ngspice found an error in it, which its return code does not say */
    bool own_steps; /* no step is longer than ngspice asks for: Gear's formula integrates, or ngspice has other breakpoints */
    bool poisoned; /* sources are NaN, so that ngspice gives up */
    bool waiting;  /* ngspice is in a transient and its caller has control */
    bool gone;     /* ngspice wished to end the process, and takes no other circuit */

    double t_now, t_data, t_asked, t_target, t_max_step, t_stop;
    double t_edge, t_corner; /* of an abrupt source; time of the last corner of a source */
    double growth;           /* largest step in the time since t_corner; a tenth of t_edge is always allowed; 0: no such limit */

    /* the step that was accepted last time, by what it follows: a sample without an edge, a ramp start, a ramp end */
    double remembered[3];
    enum { AFTER_SAMPLE, AT_RAMP, AFTER_RAMP } kind;
    bool first_of_kind;
    bool met, ramp_begins; /* the caller was met at this time point, and began an edge there */

    double *record;
    size_t record_rows, record_room;
    bool recording;

    long accepted, rejected, loads;
    FILE *log;
    char error[TEXT_BYTES];
    char trouble[TEXT_BYTES]; /* the last lines in which ngspice complained */
} ls;

/* ---- text from ngspice ------------------------------------------------------------------------------------ */

static int on_char(char *text, int id, void *user)
{
    (void)id, (void)user;
    if (ls.log)
        fprintf(ls.log, "%s\n", text);
    const char *said = strncmp(text, "stderr ", 7) ? text : text + 7;
    if (ls.loading && said != text && !strncmp(said, "Error", 5))
        ls.refused = true; /* and what follows says why */
    static const char *const words[] = {"error", "trouble", "too small", "singular", "aborted", "no convergence",
                                        "iteration limit", "undefined"};
    bool trouble = ls.loading && ls.refused && said != text;
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        trouble = trouble || strcasestr(said, words[i]);
    size_t used = strlen(ls.trouble);
    if (trouble && !strstr(ls.trouble, said))
        snprintf(ls.trouble + used, TEXT_BYTES - used, "%s%s", used ? "; " : "", said);
    return 0;
}

static int on_exit_wish(int status, NG_BOOL immediate, NG_BOOL quit, int id, void *user)
{
    (void)immediate, (void)quit, (void)id, (void)user;
    size_t used = strlen(ls.trouble);
    snprintf(ls.trouble + used, TEXT_BYTES - used, "%sngspice gave up (status %d)", used ? "; " : "", status);
    ls.state = FAILED;
    ls.gone = true;
    if (ls.log)
        fflush(ls.log);
    return 0;
}

/* ---- sources ---------------------------------------------------------------------------------------------- */

/* ngspice asks for all sources in the same order again and again, by the addresses of its own names. */
static int source_index(const char *name)
{
    int i = ls.source[ls.last].next;
    if (ls.source[i].key != name) {
        for (i = 0; i < ls.n_source && strcasecmp(ls.source[i].name, name); i++)
            ;
        if (i == ls.n_source)
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
    if (i < 0) { /* nobody would ever drive it */
        snprintf(ls.trouble, TEXT_BYTES, "the deck has an external source %.60s that was not announced", name);
        ls.state = FAILED;
    }
    /* the hidden transient by which ngspice may look for an operating point has a time of its own */
    *value = i < 0 ? 0.0 : level(&ls.source[i], ls.started ? t : 0.0);
    if (i >= 0)
        ls.source[i].asked = true;
    if (!isfinite(*value)) {
        snprintf(ls.trouble, TEXT_BYTES, "source %.60s is %g at %g s", name, *value, t);
        ls.state = FAILED;
    }
    if (ls.poisoned || ls.state == FAILED) /* it would go on to its end alone */
        *value = NAN;
    ls.loads++;
    return 0;
}

/* ---- time ------------------------------------------------------------------------------------------------- */

/* times this close are one: four operations on a time each round it by half an ulp; ngspice takes 100 ulp as one */
static double ulps(double t) { return 8.0 * 2.220446049250313e-16 * fmax(fabs(t), 1e-12); }

/* Times this close are one: a step between them would be near ngspice's smallest, 1e-11 of the largest. */
static double tiny(void) { return 1e-10 * ls.t_max_step; }

static void add_corner(double t)
{
    int i = ls.n_corner;
    while (i > 0 && ls.corner[i - 1] > t)
        i--;
    if (i > 0 && fabs(ls.corner[i - 1] - t) <= ulps(t))
        return;
    memmove(ls.corner + i + 1, ls.corner + i, (size_t)(ls.n_corner - i) * sizeof *ls.corner);
    ls.corner[i] = t;
    ls.n_corner++;
}

static bool drop_corners_until(double t)
{
    int n = 0;
    while (n < ls.n_corner && ls.corner[n] <= t + ulps(t))
        n++;
    if (n) {
        memmove(ls.corner, ls.corner + n, (size_t)(ls.n_corner - n) * sizeof *ls.corner);
        ls.n_corner -= n;
    }
    return n > 0;
}

/* Hand over to the caller if a time point stands at the time it asked for, and learn its next edges.

   Done as soon as the point is accepted, before ngspice looks whether it stands on a breakpoint, because behind a switched
   conductance the integration must start anew with backward Euler: at the edge, so that the integral does not begin half
   a ramp late, and at the end of its ramp, because the current that charged a capacitor through the closing
   switch would go on in the trapezoidal rule with alternating sign for ever. */
static void meet(double t)
{
    ls.t_now = t;
    while (t >= ls.t_target - ulps(t)) {
        int before = ls.n_corner;
        ls.waiting = true;
        swapcontext(&ls.runner, &ls.caller);
        ls.waiting = false;
        if (ls.poisoned)
            return;
        ls.met = true;
        ls.ramp_begins = ls.n_corner > before;
        for (int i = 0; i < ls.n_source; i++)
            if (ls.source[i].abrupt && ls.source[i].t >= t - ulps(t)) {
                /* ngspice ignores a breakpoint at its own time, and takes one within 100 ulp as reached */
                ngSpice_SetBkpt(ls.source[i].t + 2.0 * ulps(t));
                ngSpice_SetBkpt(ls.source[i].t + ls.source[i].t_edge);
            }
    }
}

static int on_sync(double t, double *delta, double old_delta, int redo, int id, int where, void *user)
{
    (void)old_delta, (void)id, (void)user;
    if (ls.state != RUNNING || !ls.started || ls.poisoned) /* a hidden transient: its points are nobody's samples */
        return 0;
    if (where != 0) {
        if (redo) {
            ls.rejected++;
            if (ls.first_of_kind && ls.remembered[ls.kind] > *delta)
                ls.remembered[ls.kind] = *delta;
        }
        return 0;
    }
    ls.accepted++;
    meet(t); /* without initial operating point there is no data at t = 0 */
    bool landed = drop_corners_until(t);
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
    double left = (ls.n_corner ? fmin(ls.corner[0], ls.t_target) : ls.t_target) - t;
    ls.first_of_kind = landed;
    if (landed && ls.kind != AFTER_SAMPLE)
        ls.t_corner = t;
    if (landed && !ls.own_steps) {
        /* ngspice at most doubles a step, so after a ramp of 1 ns it would need eight steps for a clock period;
           start instead with what was accepted at the same place last time, and let it be a little bolder. Gear's formula, which looks back two steps,
           is unstable where a step is more than 1 + sqrt(2) times the last. */
        *delta = fmax(*delta, fmin(1.5 * ls.remembered[ls.kind], ls.t_max_step));
    }
    if (ls.growth > 0.0) /* transistors switch behind an edge: truncation control alone let a packet be 0.4 % off */
    {
        double since = t - ls.t_corner; /* twice the share at twenty edges, when what switches has switched */
        *delta = fmin(*delta, ls.growth * fmax(0.8 * ls.t_edge, since + since * since / (20.0 * ls.t_edge)));
    }
    if (ls.accepted < 4) /* ngspice starts with backward Euler; be past it before the first edge */
        *delta = fmin(*delta, 0.2 * left);
    if (*delta > left - (ls.own_steps ? tiny() : 1e-3 * left)) /* a step that misses the corner by rounding would be halved for ever */
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
    for (int p = 0; p < ls.n_probe; p++) {
        ls.probe_vector[p] = -1;
        for (int v = 0; v < all->veccount; v++)
            if (!strcasecmp(all->vecs[v]->vecname, ls.probe_name[p]))
                ls.probe_vector[p] = v;
    }
    return 0;
}

static int on_data(pvecvaluesall all, int count, int id, void *user)
{
    (void)count, (void)id, (void)user;
    if (ls.state != RUNNING || ls.poisoned)
        return 0;
    ls.started = ls.sampled = true;
    for (int p = 0; p < ls.n_probe; p++) {
        if (ls.probe_vector[p] >= 0)
            ls.probe[p] = all->vecsa[ls.probe_vector[p]]->creal;
        ls.low[p] = fmin(ls.low[p], ls.probe[p]), ls.high[p] = fmax(ls.high[p], ls.probe[p]);
    }
    for (int v = 0; v < all->veccount; v++)
        if (all->vecsa[v]->is_scale)
            ls.t_data = all->vecsa[v]->creal;
    if (ls.recording) {
        size_t width = (size_t)ls.n_probe + 1;
        if (ls.record_rows == ls.record_room) {
            ls.record_room = ls.record_room ? 2 * ls.record_room : 4096;
            ls.record = realloc(ls.record, ls.record_room * width * sizeof(double));
            if (!ls.record)
                abort();
        }
        double *row = ls.record + ls.record_rows++ * width;
        row[0] = ls.t_data;
        memcpy(row + 1, ls.probe, (size_t)ls.n_probe * sizeof(double));
    }
    meet(ls.t_data);
    return 0;
}

/* ---- the coroutine ---------------------------------------------------------------------------------------- */

static void run(void)
{
    int rc = ngSpice_Command(ls.command);
    if (ls.state == RUNNING)
        ls.state = rc ? FAILED : ENDED;
    swapcontext(&ls.runner, &ls.caller);
}

/* ---- the interface ---------------------------------------------------------------------------------------- */

const char *lockstep_error(void) { return ls.error; }
double lockstep_time(void) { return ls.t_now; }
int lockstep_started(void) { return ls.started; }
long lockstep_accepted(void) { return ls.accepted; }
long lockstep_rejected(void) { return ls.rejected; }
long lockstep_loads(void) { return ls.n_source ? ls.loads / ls.n_source : 0; }
size_t lockstep_record_rows(void) { return ls.record_rows; }
const double *lockstep_record(void) { return ls.record; }

static int fail(const char *what)
{
    snprintf(ls.error, TEXT_BYTES, "%s%s%.3000s", what, ls.trouble[0] ? ": " : "", ls.trouble);
    ls.state = FAILED;
    if (ls.log)
        fflush(ls.log);
    return -1;
}

/* The circuit was loaded and ngspice has no solution: -2, and the process can have another circuit; -1 if it cannot. */
static int give_up(const char *what)
{
    if (ls.waiting) { /* with sources that are no number it returns by itself: its smallest step does not converge */
        ls.state = RUNNING, ls.poisoned = true;
        swapcontext(&ls.caller, &ls.runner);
    }
    bool returned = ls.state == ENDED || ls.state == ABORTED;
    fail(what);
    if (!returned)
        return -1;
    ls.state = ABORTED;
    return -2;
}

/* What `lockstep_open` takes; ngspice.py has the same fields. `start`: a command to ngspice behind the deck, which says how it
   looks for the operating point. t_edges: how long edges of each source last. late: of each probe; delay: the different times
   of these above 0, longest first. */
struct circuit {
    const char *log_path, *start, **deck, **source_names, **probe_names;
    const double *levels, *t_edges, *late, *delay;
    const int *abrupt;
    double t_edge, t_max_step, t_stop, growth;
    int n_lines, n_source, n_probe, n_delay, recording, use_ic, own_steps;
};

int lockstep_open(const struct circuit *of)
{
    static bool initialised;
    static int ident;
    int n_source = of->n_source, n_probe = of->n_probe;
    if (ls.state == RUNNING)
        return fail("this process has another circuit that did not come to its end");
    if (ls.waiting) /* the last circuit failed */
        give_up("the transient was given up");
    if (ls.waiting || ls.gone)
        return fail("ngspice takes no other circuit in this process");
    if (n_source > MAX_SOURCES || n_probe > MAX_SOURCES)
        return fail("too many sources or probes");
    if (ls.log)
        fclose(ls.log);
    ls.log = fopen(of->log_path, "a");
    if (!ls.log)
        return fail("cannot write the log");
    free(ls.record);
    /* a null pointer is all zeros, and so are CLOSED, AFTER_SAMPLE and false */
    void *stack = ls.stack;
    FILE *log = ls.log;
    memset(&ls, 0, sizeof ls);
    ls.stack = stack, ls.log = log;
    ls.n_source = n_source, ls.n_probe = n_probe, ls.n_delay = of->n_delay;
    ls.t_edge = of->t_edge, ls.t_max_step = of->t_max_step, ls.t_stop = of->t_stop, ls.growth = of->growth;
    ls.started = of->use_ic, ls.own_steps = of->own_steps, ls.recording = of->recording;
    for (int i = 0; i < n_source; i++) {
        struct source *s = &ls.source[i];
        *s = (struct source){.from = of->levels[i], .to = of->levels[i], .t = -HUGE_VAL, .t_edge = of->t_edges[i],
                             .abrupt = of->abrupt[i]};
        snprintf(s->name, sizeof s->name, "%s", of->source_names[i]);
    }
    for (int i = 0; i < n_probe; i++) {
        snprintf(ls.probe_name[i], sizeof ls.probe_name[i], "%s", of->probe_names[i]);
        ls.probe_vector[i] = -1, ls.probe[i] = NAN, ls.late[i] = of->late[i];
    }
    memcpy(ls.delay, of->delay, sizeof *ls.delay * (size_t)of->n_delay);
    for (int k = 0; k < 3; k++)
        ls.remembered[k] = of->t_max_step;

    if (!initialised) {
        if (ngSpice_Init(on_char, NULL, on_exit_wish, on_data, on_init_data, NULL, NULL))
            return fail("ngspice does not start");
        ngSpice_Init_Sync(on_source, NULL, on_sync, &ident, NULL);
        /* Debian's library evaluates transistors in two threads of OpenMP, which wait for each other by spinning: with more
           processes than cores an iteration of one channel took 3 ms instead of 0.1 ms */
        ngSpice_Command("set num_threads=1");
        initialised = true;
    } else {
        ngSpice_Command("destroy all");
        ngSpice_Command("remcirc");
        ngSpice_Command("unset cshunt_value"); /* where ngspice keeps .options cshunt, over the end of its circuit */
    }
    ls.state = READY;
    char **lines = calloc((size_t)of->n_lines + 1, sizeof *lines);
    for (int i = 0; i < of->n_lines; i++)
        lines[i] = strdup(of->deck[i]);
    ls.loading = true;
    int rc = ngSpice_Circ(lines);
    ls.loading = false;
    for (int i = 0; i < of->n_lines; i++)
        free(lines[i]);
    free(lines);
    if (rc || ls.refused || ls.state == FAILED)
        return fail("ngspice refuses the deck");
    char copy[256];
    snprintf(copy, sizeof copy, "%s", of->start);
    if (ngSpice_Command(copy))
        return fail("ngspice refuses how to start");
    /* a step further: ngspice 39 ends 1e-11 of a step before its last time, 46 earlier */
    snprintf(ls.command, sizeof ls.command, "tran %.17g %.17g 0 %.17g%s", of->t_edge, of->t_stop + of->t_max_step, of->t_max_step,
             of->use_ic ? " uic" : "");
    return 0;
}

/* Where every node stands in the operating point that the start command leads to, sources at their levels: a line
   "name value" each, in `text`. It may come from a hidden transient, so it is a guess, to be confirmed by another circuit. */
int lockstep_operating_point(char *text, int room)
{
    if (ls.state != READY)
        return fail("the circuit is not ready");
    ngSpice_Command("op");
    char *plot = ngSpice_CurPlot();
    char **names = plot ? ngSpice_AllVecs(plot) : NULL;
    int used = 0;
    for (int i = 0; names && names[i]; i++) {
        char name[512];
        snprintf(name, sizeof name, "%s.%s", plot, names[i]);
        pvector_info vector = ngGet_Vec_Info(name);
        if (!vector || vector->v_length != 1 || !vector->v_realdata || strchr(names[i], '#'))
            continue;
        used += snprintf(text + used, (size_t)(room - used), "%s %.17g\n", names[i], vector->v_realdata[0]);
        if (used >= room)
            return fail("too many nodes");
    }
    return 0;
}

/* A name that the circuit does not have: -3. A probe is looked up when ngspice begins, before it has a solution; every source
   is asked for by the first one. */
static int wrong_name(const char *name)
{
    fail("");
    snprintf(ls.error, TEXT_BYTES, "%s", name);
    return -3;
}

/* Solve up to time `to`, with those edges that begin after `after`, and unless it is a sample ahead of the rest, with all others. */
static int solve(double after, double to, bool early, int n_edge, const int *edge_source, const double *edge_time, const double *edge_level)
{
    if (ls.state != READY && ls.state != RUNNING)
        return fail(ls.state == ENDED ? "the transient has ended" : "the circuit is not running");
    if (to > ls.t_stop * (1.0 + 1e-12)) /* clocks times period may round beyond frames times slot */
        return fail("asked to go beyond the end of the transient");
    for (int i = 0; i < n_edge; i++) {
        struct source *s = &ls.source[edge_source[i]];
        double t = edge_time[i];
        if (t <= after || (t > to && early))
            continue;
        if (edge_source[i] < 0 || edge_source[i] >= ls.n_source || t < ls.t_now - ulps(t) || t > to)
            return fail("an edge lies outside the interval");
        if (t < s->t + s->t_edge - ulps(t)) {
            snprintf(ls.trouble, TEXT_BYTES, "%.60s at %.9g s", s->name, t);
            return fail("an edge begins before the last one of its source has ended");
        }
        if (ls.n_corner + 2 > MAX_CORNERS)
            return fail("too many edges in one interval");
        s->from = level(s, t);
        s->to = edge_level[i];
        s->t = t;
        add_corner(t);
        add_corner(t + s->t_edge);
    }
    if (ls.state == FAILED)
        return fail("not advanced");
    ls.t_target = to;
    if (ls.state == READY) {
        if (!ls.stack) {
            ls.stack = mmap(NULL, STACK_BYTES, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
            if (ls.stack == MAP_FAILED) {
                ls.stack = NULL;
                return fail("no memory for the stack of ngspice");
            }
        }
        getcontext(&ls.runner);
        ls.runner.uc_stack.ss_sp = ls.stack;
        ls.runner.uc_stack.ss_size = STACK_BYTES;
        ls.runner.uc_link = &ls.caller;
        makecontext(&ls.runner, run, 0);
        ls.state = RUNNING;
    }
    swapcontext(&ls.caller, &ls.runner);
    bool reached = ls.t_now >= to - ulps(to);
    if (ls.state == FAILED)
        return fail("ngspice stopped");
    for (int p = 0; p < ls.n_probe; p++)
        if (ls.probe_vector[p] < 0)
            return wrong_name(ls.probe_name[p]);
    if (!reached || !ls.started)
        return give_up(ls.started ? "ngspice stopped" : "ngspice found no operating point");
    for (int i = 0; i < ls.n_source; i++)
        if (!ls.source[i].asked)
            return wrong_name(ls.source[i].name);
    for (int p = 0; p < ls.n_probe; p++)
        if (ls.sampled && !isfinite(ls.probe[p])) {
            snprintf(ls.trouble, TEXT_BYTES, "node \"%.63s\" is %g", ls.probe_name[p], ls.probe[p]);
            return give_up("a sample is no number");
        }
    return 0;
}

/* Solve up to time `to`; edge i moves source edge_source[i] to edge_level[i], beginning at edge_time[i] in [now, to].
   samples receives the probes at `to`, late ones as they were that much earlier, at 0 for a time before; low and high
   their extremes over all time points since the last call. */
int lockstep_advance(double to, int n_edge, const int *edge_source, const double *edge_time, const double *edge_level,
                     double *samples, double *low, double *high)
{
    double after = -HUGE_VAL;
    for (int p = 0; p < ls.n_probe; p++)
        ls.low[p] = HUGE_VAL, ls.high[p] = -HUGE_VAL;
    for (int i = 0; i <= ls.n_delay; i++) {
        double late = i < ls.n_delay ? ls.delay[i] : 0.0, at = to - late;
        if (late > 0.0 && at < ls.t_asked - tiny() && ls.t_asked > 0.0) {
            snprintf(ls.trouble, TEXT_BYTES, "a probe is %g s late, but the last sample is %g s ago", late, to - ls.t_asked);
            return fail("not advanced");
        }
        if (late == 0.0 || at > ls.t_asked + tiny()) {
            int failed = solve(after, at, late > 0.0, n_edge, edge_source, edge_time, edge_level);
            if (failed)
                return failed;
            after = ls.t_asked = at;
        }
        for (int p = 0; p < ls.n_probe; p++)
            if (ls.late[p] == late || (late == 0.0 && to < ls.late[p]))
                samples[p] = ls.probe[p];
    }
    memcpy(low, ls.low, sizeof *low * (size_t)ls.n_probe);
    memcpy(high, ls.high, sizeof *high * (size_t)ls.n_probe);
    return 0;
}

/* Let a transient return, at its end or given up before, so that the process can have another circuit. */
void lockstep_close(void)
{
    if (ls.state == RUNNING && ls.t_now < ls.t_stop - 1e-10 * ls.t_max_step)
        give_up("the transient was ended");
    else if (ls.state == RUNNING) {
        ls.t_target = HUGE_VAL;
        swapcontext(&ls.caller, &ls.runner);
    }
}
