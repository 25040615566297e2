#include <math.h>
#include <string.h>

#include "card.h"
#include "constants.h"
#include "loop.h"

static int read_plus(foten_model *m, texture_file *file, const card_sizes *s, const isa *isa) {
    int width = s->excitation_width;
    m->kind = &lattice_loop;
    m->warm_up = s->network.window;
    m->excited_lattice = s->n_tones ? &m->residual : &m->lattice;
    if (!lattice_read(file, &m->memory, "lattice.", s->n_speed, s->n_force, s->order, width, s->gain_before_filter,
                      &m->lattice))
        return 0;
    if (!innovation_read(file, &m->memory, s->n_hidden, s->head_width, s->n_components, isa->innovation, &m->network))
        return 0;
    if (!excitation_read(file, &m->memory, width, &m->excitation)) return 0;
    m->excited = 1;
    if (s->equalised && !equaliser_read(file, &m->memory, &m->equaliser)) return 0;
    int step = (int)floor(FOTEN_CONTROL_MS * m->rate_hz / 1000 + 0.5);
    if (s->recorded &&
        !recorded_read(file, &m->memory, step > 1 ? step : 1, s->along_path, isa->innovation, &m->recorded))
        return 0;
    if (!s->n_tones) return 1;
    if (!tones_read(file, &m->memory, s->n_tones, s->n_tone_speed, s->n_tone_force, &m->tones)) return 0;
    return lattice_read(file, &m->memory, "residual.", s->n_residual_speed, s->n_residual_force, s->residual_order,
                        width, s->residual_gain_before_filter, &m->residual);
}

static int read_network(foten_model *m, texture_file *file, const card_sizes *s, const isa *isa) {
    network *network = network_make(file, &s->network, isa, &m->memory);
    m->predictor = (predictor){.window = s->network.window, .n_inputs = 1, .isa = isa, .network = network};
    return network != NULL;
}

/* Of a graph the file holds nothing for this library but an excitation. */
static int leave_graph(foten_model *m, texture_file *file, const card_sizes *s) {
    m->takes_noise = 1;
    m->predictor.window = s->network.window;
    m->predictor.n_inputs = FOTEN_PREDICTOR_INPUTS;
    file_leave(file, "graph");
    return 1;
}

static int read_tensors(foten_model *m, texture_file *file, const card_sizes *s, const isa *isa) {
    if (s->model == CARD_AR) {
        m->kind = &piecewise_ar_loop;
        m->excited = 1;
        m->piecewise_ar = piecewise_ar_read(file, s->order, s->ma, s->n_models, s->n_triangles, &m->memory);
        return m->piecewise_ar != NULL;
    }
    if (s->model == CARD_PLUS) return read_plus(m, file, s, isa);
    m->kind = &window_loop;
    m->excited = s->excitation;
    if (m->excited && !excitation_read(file, &m->memory, s->excitation_width, &m->excitation)) return 0;
    return s->model == CARD_GRAPH ? leave_graph(m, file, s) : read_network(m, file, s, isa);
}

int model_read(foten_model *m, texture_file *file, const isa *isa, foten_predictor function, void *user) {
    card_sizes sizes;
    m->predictor = (predictor){.function = function, .user = user};
    if (card_read_sizes(file, function != NULL, &sizes) && card_read(m, file, &sizes) &&
        read_tensors(m, file, &sizes, isa))
        return 1;
    return file_refuse(file, FOTEN_NO_MEMORY, "no memory"); /* where there is no reason yet */
}

loop *loop_place(const foten_model *m, block *from) {
    loop measured, *l = block_take(from, 1, sizeof *l), *into = l ? l : &measured;
    const network *network = m->predictor.network;
    m->kind->place(m, into, from);
    into->predictor.scratch =
        block_take(from, network ? network->scratch.n : 0, sizeof(float)); /* after all that must survive a sample */
    return l;
}

void loop_copy(const foten_model *m, loop *to, const loop *from) {
    block own = {(unsigned char *)to, 0};
    memcpy(to, from, (size_t)((unsigned char *)to->predictor.scratch - own.base));
    loop_place(m, &own); /* which sets the pointers anew, and nothing else */
}

/* The proof that a texture file carries: golden windows and steps, which have to come out as they did in training. */
enum { GOLDEN_STEPS = 64, MAX_GOLDEN = 4096 };

/* Of n golden windows or steps, how many are replayed: all, but to a fuzzer, whose time is short, two are as good as
 * many. */
static size_t replayed(size_t n) {
#ifdef FOTEN_FUZZING
    return n < 2 ? n : 2;
#else
    return n;
#endif
}

/* Whether n numbers are near enough to those in the file; a reason in the file where they are not. */
static int proven(texture_file *file, const char *what, const double *computed, const double *expected, size_t n,
                  double tolerance) {
    double worst = 0;
    for (size_t i = 0; i < n; i++) {
        double size = fabs(expected[i]) > 1 ? fabs(expected[i]) : 1, error = fabs(computed[i] - expected[i]) / size;
        if (error > worst || isnan(error)) worst = error; /* than which nothing is larger */
    }
#ifdef FOTEN_FUZZING
    tolerance = INFINITY; /* what a hostile file makes of the loop is to be reached */
    worst = 0;
#endif
    if (worst <= tolerance) return 1;
    static const char format[] =
        "the texture file fails its own proof: %s differs by %.2g scaled from what was trained, expected at most %g; "
        "is the file damaged?";
    return file_refuse(file, FOTEN_NO_PROOF, format, what, worst, tolerance);
}

/* Sixty-four steps from a warm start, and what each fed back. A network of floats in its closed loop may be chaotic,
 * and what a step rounds is a million times as large some steps later: its next step goes on from the golden sample. */
static void run_golden(const foten_model *m, loop *l, const double *warm, const double *conditions,
                       const double *golden, double *out, double *fed_back) {
    m->kind->start(m, l, warm, m->history, 0);
    for (size_t i = 0; i < replayed(GOLDEN_STEPS); i++) {
        condition c = condition_of(&m->lattice.level, conditions + 2 * i);
        double noise = noise_at(0, 0, i);
        out[i] = m->kind->step(m, l, &c, model_is_random(m) ? &noise : NULL, INFINITY);
        fed_back[i] = m->kind->replace_last ? m->kind->replace_last(m, l, golden[i]) : out[i];
    }
}

/* Replay the golden windows, with memory that is needed no longer then. */
static int prove(foten_model *m, texture_file *file, arena *memory) {
    size_t shape[4], length = (size_t)m->history;
    if (file_shape(file, "golden.one_step", shape) != 1 || shape[0] < FOTEN_MIN_GOLDEN || shape[0] > MAX_GOLDEN)
        return file_refuse(file, FOTEN_BAD_FILE,
                           "the file holds no golden windows, or not from %d to %d of them, which prove it",
                           FOTEN_MIN_GOLDEN, MAX_GOLDEN);
    size_t n = shape[0];
    const double *windows, *one_step, *conditions, *closed, *warm, *sigma = NULL;
    if (!(windows = file_take(file, memory, "golden.", "windows", (size_t[4]){n, length, 3}))) return 0;
    if (!(one_step = file_take(file, memory, "golden.", "one_step", (size_t[4]){n}))) return 0;
    if (!(conditions = file_take(file, memory, "golden.", "condition", (size_t[4]){GOLDEN_STEPS, 2}))) return 0;
    if (!(closed = file_take(file, memory, "golden.", "closed_loop", (size_t[4]){GOLDEN_STEPS}))) return 0;
    if (!(warm = file_take(file, memory, "", "warm_start", (size_t[4]){length, 3}))) return 0;
    if (m->excited && !(sigma = file_take(file, memory, "golden.", "sigma", (size_t[4]){n}))) return 0;
    if (!file_all_taken(file, m->name)) return 0;

    block size = {0};
    loop_place(m, &size);
    block begin_memory = {arena_take(&m->memory, size.used, 1), 0},
          trial_memory = {arena_take(memory, size.used, 1), 0};
    double *computed = arena_take(memory, n > GOLDEN_STEPS ? n : GOLDEN_STEPS, sizeof *computed);
    if (!begin_memory.base || !trial_memory.base || !computed) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    m->begin = loop_place(m, &begin_memory);
    loop *l = loop_place(m, &trial_memory);
    for (size_t i = 0; i < replayed(n); i++) {
        foten_prediction prediction;
        m->kind->start(m, l, windows + i * length * 3, m->history, 1);
        m->kind->predict(m, l, FOTEN_PREDICT_MODEL, 0, &prediction);
        computed[i] = prediction.sample;
    }
    if (!proven(file, "one step", computed, one_step, n, FOTEN_ONE_STEP_TOLERANCE)) return 0;
    for (size_t i = 0; sigma && i < replayed(n); i++) {
        m->kind->start(m, l, windows + i * length * 3, m->history, 0);
        computed[i] = m->kind->scale(m, l);
    }
    if (sigma && !proven(file, "the excitation", computed, sigma, n, FOTEN_ONE_STEP_TOLERANCE)) return 0;
    m->kind->start(m, m->begin, warm, m->history, 0);
    double *fed_back = arena_take(memory, GOLDEN_STEPS, sizeof *fed_back);
    if (!fed_back) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    run_golden(m, l, warm, conditions, closed, computed, fed_back);
    static const char what[] = "64 closed-loop steps";
    return proven(file, what, computed, closed, GOLDEN_STEPS, FOTEN_CLOSED_LOOP_TOLERANCE) &&
           proven(file, what, fed_back, closed, GOLDEN_STEPS, FOTEN_CLOSED_LOOP_TOLERANCE);
}

int model_prove(foten_model *m, texture_file *file) {
    arena memory = {0};
    int fits = prove(m, file, &memory);
    arena_free(&memory);
    return fits;
}
