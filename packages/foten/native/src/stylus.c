#include "stylus.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>

#include "constants.h"
#include "filter.h"
#include "model.h"

enum { MAX_WAITING = 256 };           /* events */
enum { MAX_LATE = 8 };                /* late events in succession after which the device has restarted its clock */
static const double MAX_SPEED = 5000; /* mm/s; faster is a pen that was lifted */
/* A pen is out of reach after so many usual steps without an event, and that long at least. */
static const double HOLE_STEPS = 10, MIN_HOLE_S = 0.04;
/* It is still after so many, and that long at least. */
static const double STILL_STEPS = 3, MIN_STILL_S = 0.025;
/* Of a usual step: events that waited somewhere and came at once are none to go by. */
static const double MIN_STEP_S = 0.0005, MAX_STEP_S = 0.05;
/* Half of a change of velocity is carried on where events are that far apart. */
static const double CARRIED_S = 0.005;

typedef struct {
    double x, y, pressure, t;
} event;
struct foten_stylus {
    double period_s, newtons, steepness;
    section filter;
    memory velocity_memory[2], force_memory;

    event waiting[MAX_WAITING];
    _Atomic uint64_t n_pushed, n_taken; /* by the device's thread, by the rendering one */
    _Atomic uint64_t n_refused, n_dropped, n_clipped;

    /* The rendering thread's own. */
    event last;
    int known, touching, moving, still; /* moving: whether `velocity` is of this stroke */
    unsigned late_in_succession;
    double late_t, usual_s, since_s;
    double velocity[2], held[2], normal_force; /* held: until the next event */
    _Atomic uint64_t n, n_late, n_jumps;
};

foten_stylus *foten_stylus_new(const foten_model *model, const foten_stylus_options *options) {
    foten_stylus_options o = options ? *options : (foten_stylus_options){0, 0};
    if (!model || !(o.newtons >= 0 && o.newtons < 1e6 && fabs(o.steepness) < 100)) return NULL;
    foten_stylus *s = calloc(1, sizeof *s);
    if (!s) return NULL;
    s->period_s = 1 / model->rate_hz;
    s->newtons = o.newtons > 0 ? o.newtons : FOTEN_STYLUS_NEWTONS;
    s->steepness = o.steepness != 0 ? o.steepness : FOTEN_STYLUS_STEEPNESS;
    s->filter = lowpass(model->lowpass_hz, model->rate_hz);
    s->usual_s = 1.0 / 120;
    return s;
}

void foten_stylus_free(foten_stylus *stylus) { free(stylus); }

static void count(_Atomic uint64_t *of) { atomic_fetch_add_explicit(of, 1, memory_order_relaxed); }

void foten_stylus_push(foten_stylus *s, double x, double y, double pressure, double t) {
    if (!s) return;
    if (!isfinite(x) || !isfinite(y) || !isfinite(pressure) || !isfinite(t)) {
        count(&s->n_refused);
        return;
    }
    uint64_t pushed = atomic_load_explicit(&s->n_pushed, memory_order_relaxed);
    if (pushed - atomic_load_explicit(&s->n_taken, memory_order_acquire) == MAX_WAITING) {
        count(&s->n_dropped);
        return;
    }
    double cut = pressure < 0 ? 0 : pressure > 1 ? 1 : pressure;
    if (cut != pressure) count(&s->n_clipped);
    s->waiting[pushed % MAX_WAITING] = (event){x, y, cut, t};
    atomic_store_explicit(&s->n_pushed, pushed + 1, memory_order_release);
}

/* Whether an event is none to go by: it is not later than the last one, and no new clock either. */
static int late(foten_stylus *s, const event *e) {
    if (!s->known || e->t > s->last.t) {
        s->late_in_succession = 0;
        return 0;
    }
    count(&s->n_late);
    s->late_in_succession = s->late_in_succession && e->t > s->late_t ? s->late_in_succession + 1 : 1;
    s->late_t = e->t;
    if (s->late_in_succession < MAX_LATE) return 1;
    s->late_in_succession = 0;
    s->known = 0;
    return 0;
}

static double length(const double v[2]) { return sqrt(v[0] * v[0] + v[1] * v[1]); }

/* Take in the events since the last sample. */
static void take_events(foten_stylus *s) {
    uint64_t pushed = atomic_load_explicit(&s->n_pushed, memory_order_acquire),
             taken = atomic_load_explicit(&s->n_taken, memory_order_relaxed);
    double displacement[2] = {0, 0}, duration_s = 0;
    int jumped = 0;
    for (; taken < pushed; taken++) {
        event e = s->waiting[taken % MAX_WAITING];
        if (late(s, &e)) continue;
        count(&s->n);
        double step = e.t - s->last.t, dx = e.x - s->last.x, dy = e.y - s->last.y;
        int touches = e.pressure > 0, goes_on = s->known && s->touching && touches;
        double hole = HOLE_STEPS * s->usual_s > MIN_HOLE_S ? HOLE_STEPS * s->usual_s : MIN_HOLE_S;
        if (goes_on && (step > hole || sqrt(dx * dx + dy * dy) > MAX_SPEED * step)) {
            count(&s->n_jumps);
            goes_on = 0;
        }
        if (goes_on) {
            displacement[0] += dx;
            displacement[1] += dy;
            duration_s += step;
            if (step > MIN_STEP_S && step < MAX_STEP_S) s->usual_s += 0.1 * (step - s->usual_s);
        } else {
            displacement[0] = displacement[1] = duration_s = 0;
            jumped = 1;
        }
        s->known = 1;
        s->touching = touches;
        s->last = e;
        s->normal_force = touches ? s->newtons * exp(s->steepness * e.pressure) : 0;
        s->since_s = s->still = 0;
    }
    atomic_store_explicit(&s->n_taken, taken, memory_order_release);
    if (jumped) s->held[0] = s->held[1] = 0;
    if (duration_s > 0) {
        double velocity[2], change[2];
        for (int i = 0; i < 2; i++) {
            velocity[i] = displacement[i] / duration_s;
            change[i] = s->moving && !jumped ? velocity[i] - s->velocity[i] : 0;
        }
        /* What is carried on is at most what is there: a pen that stops would turn back otherwise, and start another
         * movement. */
        double share = duration_s / (duration_s + CARRIED_S), speed = length(velocity),
               carried = share * length(change);
        if (carried > speed) share *= speed / carried;
        for (int i = 0; i < 2; i++) {
            s->held[i] = velocity[i] + share * change[i];
            s->velocity[i] = velocity[i];
        }
    }
    s->moving = duration_s > 0 || (s->moving && !jumped);
}

/* Within a block no event can come, however long it lasts: whether the pen has stopped is seen where one begins. */
void stylus_block(foten_stylus *s) {
    double usual = STILL_STEPS * s->usual_s;
    s->still = s->since_s > (usual > MIN_STILL_S ? usual : MIN_STILL_S);
}

void stylus_next(foten_stylus *s, double out[2]) {
    take_events(s);
    if (s->still) s->held[0] = s->held[1] = s->velocity[0] = s->velocity[1] = 0;
    s->since_s += s->period_s;
    double x = filtered(&s->filter, &s->velocity_memory[0], s->held[0]),
           y = filtered(&s->filter, &s->velocity_memory[1], s->held[1]);
    double force = filtered(&s->filter, &s->force_memory, s->normal_force);
    out[0] = sqrt(x * x + y * y);
    out[1] = force > 0 ? force : 0; /* a second-order low-pass undershoots by 4 % */
}

void foten_stylus_next(foten_stylus *s, float *speed, float *force) {
    double speed_force[2];
    if (!s || !speed || !force) return;
    stylus_block(s);
    stylus_next(s, speed_force);
    *speed = (float)speed_force[0];
    *force = (float)speed_force[1];
}

foten_stylus_stats foten_stylus_statistics(const foten_stylus *stylus) {
    foten_stylus *s = (foten_stylus *)stylus; /* an atomic load does not change it */
    if (!s) return (foten_stylus_stats){0};
    return (foten_stylus_stats){atomic_load(&s->n),         atomic_load(&s->n_refused), atomic_load(&s->n_late),
                                atomic_load(&s->n_dropped), atomic_load(&s->n_clipped), atomic_load(&s->n_jumps)};
}
