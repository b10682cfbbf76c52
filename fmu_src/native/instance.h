/* One instance of what is exported: values, start and reset, communication steps, saved states.
 *
 * Knows FMI's rules and no physics. model.h, written for each export, brings the table of variables, the start
 * values and the functions; its MOTION names axis.h or controller.h, which say how these go through a step.
 * fmi2.c and fmi3.c put the standard's names on what is here. Memory is taken when an instance is made and when an
 * importer asks for a copy of the state, at no other time.
 */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <locale.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#endif

/* When a variable may be set. */
typedef enum { NEVER, BEFORE_START, ANY_TIME } Settable;

typedef struct {
    const char *name;
    size_t slot; /* where its value stands in State.slot */
    double least, most;
    Settable settable;
    int differentiable; /* whether derivatives with respect to it are known */
} Variable;

#include "model.h"

typedef enum { MADE, INITIALIZING, RUNNING, EVENTS, CONTINUOUS, ENDED } Mode;

/* Everything that a saved state holds. */
typedef struct {
    double slot[SLOTS];
#if DERIVATIVES
    double last[SLOTS]; /* as the last communication step found it */
    double span; /* of that step; 0 before the first */
#endif
    double begin, now; /* the importer's time at the start, and now */
    Mode mode;
    int exchange; /* instantiated for model exchange */
    int stale; /* a value was set since the last refresh */
#if EXCHANGE
    double settled; /* the command under which modes were chosen */
#endif
} State;

typedef struct {
    State state;
    double start[SLOTS]; /* what reset returns to: compiled-in, overridden by resources/parameters.txt */
    char name[128];
    void *environment;
    void (*logger)(void); /* the importer's, in the standard's own type */
} Instance;

/* Hand a sentence to the importer; defined by fmi2.c and fmi3.c. */
static void tell(const Instance *me, const char *sentence);

#if defined __GNUC__
__attribute__((format(printf, 2, 3)))
#endif
static int refuse(const Instance *me, const char *format, ...)
{
    char sentence[512];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    tell(me, sentence);
    return 0;
}

/* Defined by MOTION. */
#if EXCHANGE
static void settle_modes(State *s); /* modes as the values ask for */
static int is_unsettled(const State *s); /* whether motion or command contradict the modes */
#endif
#if DERIVATIVES
/* From the slopes of what is known, in `d` by slot, to those of all that follows from it. */
static int differentiate(Instance *me, double *d);
#endif
static void refresh(State *s); /* bring up to date what follows from other values */
static int move(Instance *me, double span); /* go on by a span under the inputs as they are */
static int is_sound(const Instance *me, const State *s); /* whether a state from outside can be continued without harm */

/* ---- values ---- */

static int acceptable(const Instance *me, const Variable *v, double value)
{
    if (!isfinite(value)) return refuse(me, "%s is not a finite number: give one", v->name);
    if (value < v->least || value > v->most)
        return refuse(me, "%s = %.9g is outside [%.9g, %.9g]: correct it", v->name, value, v->least, v->most);
    return 1;
}

static int set_value(Instance *me, size_t reference, double value)
{
    State *s = &me->state;
    if (reference >= VARIABLES) return refuse(me, "no variable has the value reference %u", (unsigned)reference);
    const Variable *v = &variables[reference];
    if (v->settable == NEVER) return refuse(me, "%s is not an input or a parameter: it cannot be set", v->name);
    if (v->settable == BEFORE_START && s->mode != MADE && s->mode != INITIALIZING)
        return refuse(me, "%s can be set only before the simulation starts", v->name);
    if (s->mode == ENDED) return refuse(me, "%s cannot be set after the end: reset first", v->name);
    if (!acceptable(me, v, value)) return 0;
    s->slot[v->slot] = value;
    s->stale = 1;
    return 1;
}

static int get_value(Instance *me, size_t reference, double *value)
{
    if (reference >= VARIABLES) return refuse(me, "no variable has the value reference %u", (unsigned)reference);
    if (me->state.stale) refresh(&me->state);
    *value = me->state.slot[variables[reference].slot];
    return 1;
}

/* ---- start values from the unpacked FMU ---- */

static FILE *open_for_reading(const char *path)
{
#ifdef _WIN32
    wchar_t wide[4096];
    if (MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, 4096) == 0) return NULL;
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

static int from_hex(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}

/* The path behind a file URI (a plain path is left as it is); 0 where it does not fit. */
static int path_from_uri(const char *uri, char *path, size_t size)
{
    int escaped = strncmp(uri, "file:", 5) == 0;
    if (escaped) {
        uri += 5;
        if (strncmp(uri, "//", 2) == 0) {
            uri += 2;
            while (*uri != '\0' && *uri != '/') ++uri;
        }
#ifdef _WIN32
        if (*uri == '/') ++uri;
#endif
    }
    size_t n = 0;
    while (*uri != '\0') {
        if (n + 1 >= size) return 0;
        int high = -1, low = -1;
        if (escaped && uri[0] == '%') {
            high = from_hex(uri[1]);
            low = high < 0 ? -1 : from_hex(uri[2]);
        }
        if (low >= 0) {
            path[n++] = (char)(16 * high + low);
            uri += 3;
        } else {
            path[n++] = *uri++;
        }
    }
    path[n] = '\0';
    return 1;
}

static int read_line(Instance *me, char *line)
{
    char *number = strchr(line, ' ');
    if (number == NULL) return refuse(me, "resources/parameters.txt: '%.80s' is not a name and a value", line);
    *number++ = '\0';
    /* strtod reads the decimal point of the host's locale. */
    char *point = strchr(number, '.');
    const struct lconv *local = localeconv();
    if (point != NULL && local->decimal_point[0] != '\0' && local->decimal_point[1] == '\0')
        *point = local->decimal_point[0];
    char *end;
    double value = strtod(number, &end);
    if (end == number || strspn(end, " \r\n") != strlen(end))
        return refuse(me, "resources/parameters.txt: %.80s has no number as its value", line);
    for (size_t i = 0; i < VARIABLES; ++i) {
        if (variables[i].settable == NEVER || strcmp(variables[i].name, line) != 0) continue;
        if (!acceptable(me, &variables[i], value)) return 0;
        me->start[variables[i].slot] = value;
        return 1;
    }
    return refuse(me, "resources/parameters.txt: %.80s is not a parameter of this model", line);
}

/* The values of the last update stand in the resources only: without them an old axis would run in silence. */
static int load_start_values(Instance *me, const char *resources)
{
    char path[4096], line[256];
    if (resources == NULL || resources[0] == '\0')
        return refuse(me, "the importer gave no resource location, where the start values are: give the folder resources");
    if (!path_from_uri(resources, path, sizeof path - sizeof "/parameters.txt"))
        return refuse(me, "the path of the resources is longer than %u characters: unpack elsewhere", (unsigned)sizeof path);
    size_t n = strlen(path);
    if (n > 0 && path[n - 1] != '/' && path[n - 1] != '\\') strcat(path, "/");
    strcat(path, "parameters.txt");
    FILE *file = open_for_reading(path);
    if (file == NULL)
        return refuse(me, "the start values in %.400s cannot be read: unpack the whole FMU", path);
    int good = 1;
    while (good && fgets(line, sizeof line, file) != NULL)
        if (line[0] != '#' && line[strspn(line, " \r\n")] != '\0') good = read_line(me, line);
    fclose(file);
    return good;
}

/* ---- life ---- */

static void restart(Instance *me)
{
    State *s = &me->state;
    int exchange = s->exchange;
    memset(s, 0, sizeof *s);
    memcpy(s->slot, me->start, sizeof me->start);
    s->exchange = exchange;
    s->mode = MADE;
    refresh(s);
}

/* A new instance, or NULL with the reason told. */
static Instance *make(const char *name, const char *token, const char *resources, int exchange, void *environment,
                      void (*logger)(void))
{
    Instance *me = calloc(1, sizeof *me);
    if (me == NULL) return NULL;
    snprintf(me->name, sizeof me->name, "%s", name == NULL ? "" : name);
    me->environment = environment;
    me->logger = logger;
    me->state.exchange = exchange;
    memcpy(me->start, compiled_in, sizeof compiled_in);
    int good = 1;
    if (token == NULL || strcmp(token, TOKEN) != 0)
        good = refuse(me, "the model description belongs to another build: its GUID or token is not %s", TOKEN);
    if (exchange && !EXCHANGE) good = refuse(me, "this FMU is for co-simulation only");
    if (!good || !load_start_values(me, resources)) {
        free(me);
        return NULL;
    }
    restart(me);
    return me;
}

static int change_mode(Instance *me, Mode from, Mode to, const char *what)
{
    if (me->state.mode != from) return refuse(me, "%s was called out of turn", what);
    me->state.mode = to;
    return 1;
}

static int begin_at(Instance *me, double time)
{
    if (!isfinite(time)) return refuse(me, "the start time is not a finite number");
    if (me->state.mode != MADE) return refuse(me, "the start time was given after initialization");
    me->state.begin = me->state.now = time;
    return 1;
}

static int start(Instance *me)
{
    if (me->state.mode != INITIALIZING) return refuse(me, "initialization ended without having begun");
    refresh(&me->state);
    me->state.mode = me->state.exchange ? EVENTS : RUNNING;
    return 1;
}

static int end(Instance *me)
{
    if (me->state.mode < RUNNING) return refuse(me, "the end was called before the start");
    me->state.mode = ENDED;
    return 1;
}

/* ---- communication steps ---- */

static int communicate(Instance *me, double from, double span)
{
    State *s = &me->state;
    if (s->exchange) return refuse(me, "this instance is for model exchange: it takes no communication steps");
    if (s->mode != RUNNING) return refuse(me, "a step was asked for before the end of initialization or after the end");
    if (!isfinite(from) || !isfinite(span)) return refuse(me, "the time or the length of a step is not a finite number");
    if (span < 0.0) return refuse(me, "a step of %.9g s goes back in time: steps are positive", span);
    /* Importers round their clock, some to single precision: a hundredth of the step is no gap. */
    double slack = 1e-9 * fmax(1.0, fabs(s->now)) + 0.01 * span;
    if (from < s->now - slack)
        return refuse(me, "time goes back from %.9g s to %.9g s: restore a saved state or reset", s->now, from);
    if (from > s->now + slack)
        return refuse(me, "time jumps from %.9g s to %.9g s: a step starts where the last one ended", s->now, from);
#if DERIVATIVES
    memcpy(s->last, s->slot, sizeof s->last);
    s->span = span;
#endif
    if (span > 0.0 && !move(me, span)) return 0;
    s->now = from + span;
    refresh(s);
    for (size_t i = 0; i < STATES; ++i)
        if (!isfinite(s->slot[FIRST_STATE + i]))
            return refuse(me, "the result is no longer finite at %.9g s: check the parameters", s->now);
    return 1;
}

/* ---- model exchange ---- */

static int set_time(Instance *me, double time)
{
    if (!me->state.exchange) return refuse(me, "the time is set in model exchange only");
    if (!isfinite(time)) return refuse(me, "the time is not a finite number");
    me->state.now = time;
    me->state.stale = 1;
    return 1;
}

/* Copy `n` of the values behind FIRST_STATE that `which` lists. */
static int get_listed(Instance *me, const size_t *which, size_t listed, double *values, size_t n)
{
    if (!me->state.exchange) return refuse(me, "this instance is for co-simulation: it has no continuous states");
    if (n != listed) return refuse(me, "there are %u values, not %u", (unsigned)listed, (unsigned)n);
    if (me->state.stale) refresh(&me->state);
    for (size_t i = 0; i < n; ++i) values[i] = me->state.slot[FIRST_STATE + which[i]];
    return 1;
}

static int set_continuous(Instance *me, const double *values, size_t n)
{
    if (!me->state.exchange) return refuse(me, "this instance is for co-simulation: it has no continuous states");
    if (n != CONTINUOUS_STATES)
        return refuse(me, "there are %u continuous states, not %u", (unsigned)CONTINUOUS_STATES, (unsigned)n);
    for (size_t i = 0; i < n; ++i)
        if (!isfinite(values[i])) return refuse(me, "a continuous state is not a finite number");
    for (size_t i = 0; i < n; ++i) me->state.slot[FIRST_STATE + continuous[i]] = values[i];
    me->state.stale = 1;
    return 1;
}

static int get_nominals(Instance *me, double *values, size_t n)
{
    if (n != CONTINUOUS_STATES) return refuse(me, "there are %u continuous states", (unsigned)CONTINUOUS_STATES);
    memcpy(values, nominal, n * sizeof *values);
    return 1;
}

/* The end of an event: the next one that is known by its time.
 *
 * Importers are told each time that states have changed: many restart their solver for nothing less, and one that goes
 * on with rates of the mode before is wrong.
 */
static int update(Instance *me, int *timed, double *next)
{
    State *s = &me->state;
    *timed = 0;
    *next = 0.0;
    if (!s->exchange || s->mode != EVENTS) return refuse(me, "discrete states were updated outside the event mode");
#if EXCHANGE
    refresh(s);
    settle_modes(s);
    s->stale = 1;
#if TIMED
    *next = s->begin + s->slot[EVENT_TIME] - s->slot[TIME_START];
    *timed = *next > s->now;
#endif
#endif
    return 1;
}

/* Whether an event is asked for after a step of the solver.
 *
 * Not all of them look for a change of sign, and some go on through a new command with what the old one told them.
 */
static int step_completed(Instance *me)
{
#if EXCHANGE
    State *s = &me->state;
    if (s->stale) refresh(s);
    return is_unsettled(s);
#else
    (void)me;
    return 0;
#endif
}

/* ---- derivatives ---- */

/* The slopes of `n` unknowns along a direction: `m` knowns and how fast each changes.
 *
 * Under an outside solver unknowns are functions of states, input and parameters at this moment. In co-simulation they
 * are functions of what the last communication step began with: states then, the input held during it, parameters.
 */
static int slopes(Instance *me, const unsigned *unknowns, size_t n, const unsigned *knowns, size_t m, const double *seed,
                  double *out)
{
#if DERIVATIVES
    double d[SLOTS] = {0.0};
    for (size_t i = 0; i < m; ++i) {
        if (knowns[i] >= VARIABLES) return refuse(me, "no variable has the value reference %u", knowns[i]);
        const Variable *v = &variables[knowns[i]];
        if (!v->differentiable) return refuse(me, "derivatives with respect to %s are not known", v->name);
        d[v->slot] += seed[i];
    }
    for (size_t i = 0; i < n; ++i)
        if (unknowns[i] >= VARIABLES) return refuse(me, "no variable has the value reference %u", unknowns[i]);
    if (me->state.stale) refresh(&me->state);
    if (!differentiate(me, d)) return 0;
    for (size_t i = 0; i < n; ++i) out[i] = d[variables[unknowns[i]].slot];
    return 1;
#else
    (void)unknowns, (void)n, (void)knowns, (void)m, (void)seed, (void)out;
    return refuse(me, "directional derivatives are not offered by this FMU");
#endif
}

/* ---- saved states ---- */

static int save(const Instance *me, void **saved)
{
    if (*saved == NULL) *saved = malloc(sizeof(State));
    if (*saved == NULL) return refuse(me, "there is no memory for a saved state");
    memcpy(*saved, &me->state, sizeof(State));
    return 1;
}

static int restore(Instance *me, const void *saved)
{
    if (saved == NULL) return refuse(me, "there is no saved state to restore");
    memcpy(&me->state, saved, sizeof(State));
    return 1;
}

#define SERIALIZED (sizeof TOKEN + sizeof(State))

static int serialize(const Instance *me, const void *saved, void *bytes, size_t size)
{
    if (saved == NULL || size < SERIALIZED) return refuse(me, "a serialized state needs %u bytes", (unsigned)SERIALIZED);
    memcpy(bytes, TOKEN, sizeof TOKEN);
    memcpy((char *)bytes + sizeof TOKEN, saved, sizeof(State));
    return 1;
}

static int deserialize(const Instance *me, const void *bytes, size_t size, void **saved)
{
    if (size < SERIALIZED || memcmp(bytes, TOKEN, sizeof TOKEN) != 0)
        return refuse(me, "these bytes are not a saved state of this model");
    if (*saved == NULL) *saved = malloc(sizeof(State));
    if (*saved == NULL) return refuse(me, "there is no memory for a saved state");
    State *s = *saved;
    memcpy(s, (const char *)bytes + sizeof TOKEN, sizeof(State));
    if (!is_sound(me, s) || (int)s->mode < MADE || (int)s->mode > ENDED || (s->exchange && !EXCHANGE)) {
        free(s);
        *saved = NULL;
        return refuse(me, "these bytes are not a saved state of this model");
    }
    return 1;
}

#include MOTION

#endif
