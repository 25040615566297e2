#include "card.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "constants.h"

enum { MAX_LAYERS = 64 };
static const double LARGEST[3] = {1e5, 1e5, 1e4}; /* m/s2, mm/s and N that a card may speak of */
static const double LARGEST_SATURATION = 1e4;     /* standard deviations */

static const struct {
    const char *name;
    int bit, window; /* its usual one */
} MODELS[] = {{"foten-plus", CARD_PLUS, FOTEN_USUAL_PLUS_WINDOW},
              {"foten", CARD_FOTEN, FOTEN_USUAL_WINDOW},
              {"ten", CARD_TEN, FOTEN_USUAL_TEN_WINDOW},
              {"ar", CARD_AR, FOTEN_USUAL_AR_WINDOW}};

/* Counts, and switches, which are true or false. */
enum { SWITCH = -1 };
static const struct {
    const char *name;
    int of; /* which models have it */
    size_t at;
    int usual, least;
} SIZES[] = {
    {"window", CARD_NETWORKS | CARD_PLUS | CARD_AR | CARD_GRAPH, offsetof(card_sizes, network.window), 0, 2},
    {"d_model", CARD_NETWORKS, offsetof(card_sizes, network.d_model), FOTEN_USUAL_D_MODEL, 1},
    {"n_heads", CARD_NETWORKS, offsetof(card_sizes, network.n_heads), FOTEN_USUAL_N_HEADS, 1},
    {"n_layers", CARD_NETWORKS, offsetof(card_sizes, network.n_layers), FOTEN_USUAL_N_LAYERS, 1},
    {"d_feedforward", CARD_NETWORKS, offsetof(card_sizes, network.d_feedforward), FOTEN_USUAL_D_FEEDFORWARD, 1},
    {"spectral_width", CARD_FOTEN, offsetof(card_sizes, network.spectral_width), FOTEN_USUAL_SPECTRAL_WIDTH, 1},
    {"n_hidden", CARD_PLUS, offsetof(card_sizes, n_hidden), FOTEN_USUAL_N_HIDDEN, 1},
    {"head_width", CARD_PLUS, offsetof(card_sizes, head_width), FOTEN_USUAL_HEAD_WIDTH, 1},
    {"n_components", CARD_PLUS, offsetof(card_sizes, n_components), FOTEN_USUAL_N_COMPONENTS, 1},
    {"excitation_width", CARD_NETWORKS | CARD_PLUS | CARD_GRAPH, offsetof(card_sizes, excitation_width),
     FOTEN_USUAL_EXCITATION_WIDTH, 1},
    {"order", CARD_PLUS, offsetof(card_sizes, order), FOTEN_USUAL_ORDER, 1},
    {"order", CARD_AR, offsetof(card_sizes, order), FOTEN_USUAL_AR_ORDER, 1},
    {"n_speed", CARD_PLUS, offsetof(card_sizes, n_speed), 1, 1},
    {"n_force", CARD_PLUS, offsetof(card_sizes, n_force), 1, 1},
    {"n_tones", CARD_PLUS, offsetof(card_sizes, n_tones), 0, 0},
    {"n_tone_speed", CARD_PLUS, offsetof(card_sizes, n_tone_speed), 1, 1},
    {"n_tone_force", CARD_PLUS, offsetof(card_sizes, n_tone_force), 1, 1},
    {"residual_order", CARD_PLUS, offsetof(card_sizes, residual_order), 1, 1},
    {"n_residual_speed", CARD_PLUS, offsetof(card_sizes, n_residual_speed), 1, 1},
    {"n_residual_force", CARD_PLUS, offsetof(card_sizes, n_residual_force), 1, 1},
    {"ma", CARD_AR, offsetof(card_sizes, ma), 0, 0},
    {"n_models", CARD_AR, offsetof(card_sizes, n_models), 3, 3},
    {"n_triangles", CARD_AR, offsetof(card_sizes, n_triangles), 1, 1},
    {"pre_norm", CARD_NETWORKS, offsetof(card_sizes, network.pre_norm), 1, SWITCH},
    {"excitation", CARD_TEN | CARD_FOTEN | CARD_GRAPH, offsetof(card_sizes, excitation), 0, SWITCH},
    {"equalised", CARD_PLUS, offsetof(card_sizes, equalised), 0, SWITCH},
    {"recorded", CARD_PLUS, offsetof(card_sizes, recorded), 0, SWITCH},
    {"along_path", CARD_PLUS, offsetof(card_sizes, along_path), 0, SWITCH},
    {"gain_before_filter", CARD_PLUS, offsetof(card_sizes, gain_before_filter), 0, SWITCH},
    {"residual_gain_before_filter", CARD_PLUS, offsetof(card_sizes, residual_gain_before_filter), 0, SWITCH},
};

#define N(table) (int)(sizeof(table) / sizeof *(table))
#define FIELD(s, offset) (*(int *)(void *)((char *)(s) + (offset)))

static int wrong_size(texture_file *file, const char *name) {
    return file_refuse(file, FOTEN_BAD_FILE, "'%s' among the sizes in the card is none that this library can run",
                       name);
}

/* Which model a file is of, and the window that it usually has. */
static int read_model(texture_file *file, int has_function, card_sizes *s, int *usual_window) {
    json model = json_member(file->card, "model");
    for (int i = 0; i < N(MODELS); i++)
        if (json_is_string(model, MODELS[i].name)) {
            s->model = MODELS[i].bit;
            *usual_window = MODELS[i].window;
        }
    if (!s->model && file_has(file, "graph"))
        s->model = CARD_GRAPH; /* of whatever name, which predicts the next sample */
    if (!s->model)
        return file_refuse(
            file, FOTEN_BAD_FILE,
            "this library does not run the file's model, expected foten-plus, foten, ten, ar or a graph");
    if (s->model == CARD_GRAPH && !has_function)
        return file_refuse(file, FOTEN_NO_PREDICTOR,
                           "the file's model is a graph that something else has to run, ONNX Runtime from Python for "
                           "one: foten_model_load_with");
    return 1;
}

/* Two widths in a list, where there is one. */
static int read_head(json list, int widths[2]) {
    json items[2];
    long long width;
    widths[0] = FOTEN_USUAL_HEAD_1;
    widths[1] = FOTEN_USUAL_HEAD_2;
    if (list.begin && json_items(list, items, 2) != 2) return 0;
    for (int i = 0; list.begin && i < 2; i++) {
        if (!json_integer(items[i], &width) || width < 1 || width > FOTEN_MAX_COUNT) return 0;
        widths[i] = (int)width;
    }
    return 1;
}

/* What sizes have to be to one another. */
static int check_sizes(texture_file *file, card_sizes *s) {
    network_sizes *n = &s->network;
    if (n->window > (s->model == CARD_GRAPH ? FOTEN_MAX_GRAPH_WINDOW : FOTEN_MAX_WINDOW))
        return wrong_size(file, "window");
    if (s->model == CARD_GRAPH) return 1;
    if (s->model == CARD_AR) {
        if (s->order > FOTEN_MAX_AR_ORDER) return wrong_size(file, "order");
        if (s->ma > FOTEN_MAX_AR_ORDER) return wrong_size(file, "ma");
        return n->window > s->order || wrong_size(file, "window");
    }
    if (s->model == CARD_PLUS) return 1;
    if (n->n_layers > MAX_LAYERS) return wrong_size(file, "n_layers");
    if (n->d_model % n->n_heads || (n->spectral_width > 1 && n->spectral_width % n->n_heads))
        return wrong_size(file, "n_heads");
    n->fourier = s->model != CARD_TEN;
    return 1;
}

/* A size, where models of that kind have it, counted. */
static json size_named(json from, const char *name, int has, size_t *n_known) {
    json value = has ? json_member(from, name) : (json){NULL, NULL};
    *n_known += value.begin != NULL;
    return value;
}

int card_read_sizes(texture_file *file, int has_function, card_sizes *s) {
    json from = json_member(file->card, "sizes"), value;
    long long version;
    size_t n_known = 0;
    int usual_window = 0; /* a graph has none: its card has to name it */
    *s = (card_sizes){0};
    if (!json_integer(json_member(file->card, "format_version"), &version))
        return file_refuse(file, FOTEN_BAD_FILE, "the card has no format version");
    if (version != FOTEN_FORMAT_VERSION)
        return file_refuse(
            file, FOTEN_BAD_FILE, "the file has format version %lld, expected %d: %s", version, FOTEN_FORMAT_VERSION,
            version < FOTEN_FORMAT_VERSION ? "train it again: foten train RECORDING -o NAME.foten" : "update foten");
    if (!from.begin || *from.begin != '{') return file_refuse(file, FOTEN_BAD_FILE, "the card has no 'sizes'");
    if (!read_model(file, has_function, s, &usual_window)) return 0;
    for (int i = 0; i < N(SIZES); i++) {
        if (!(SIZES[i].of & s->model)) continue;
        int on = SIZES[i].usual, is_switch = SIZES[i].least == SWITCH;
        long long count = i ? SIZES[i].usual : usual_window;
        value = size_named(from, SIZES[i].name, 1, &n_known);
        if (value.begin && !(is_switch ? json_boolean(value, &on) : json_integer(value, &count)))
            return wrong_size(file, SIZES[i].name);
        if (!is_switch && (count < SIZES[i].least || count > FOTEN_MAX_COUNT)) return wrong_size(file, SIZES[i].name);
        FIELD(s, SIZES[i].at) = is_switch ? on : (int)count;
    }
    value = size_named(from, "bins", s->model == CARD_FOTEN, &n_known);
    s->network.half_bins = json_is_string(value, "half");
    if (value.begin && !s->network.half_bins && !json_is_string(value, "all")) return wrong_size(file, "bins");
    if (!read_head(size_named(from, "head", s->model & CARD_NETWORKS, &n_known), s->network.head))
        return wrong_size(file, "head");
    if (s->model == CARD_PLUS) s->excitation = 1;
    if (json_count(from) != n_known)
        return file_refuse(file, FOTEN_BAD_FILE,
                           "the card has a size that this library does not know; is the library older than the file?");
    return check_sizes(file, s);
}

static int numbers(json list, double *out, int n) {
    json items[3];
    if (json_items(list, items, n) != n) return 0;
    for (int i = 0; i < n; i++)
        if (!json_number(items[i], &out[i]) || !(fabs(out[i]) < 1e300)) return 0;
    return 1;
}

static int text_of(json value, arena *memory, char **out) {
    if (!value.begin || *value.begin != '"') return 0;
    size_t room = (size_t)(value.end - value.begin);
    *out = arena_take(memory, room, 1);
    return *out && json_string(value, *out, room) >= 0;
}

/* Speed in m/s would be rendered as if it were in mm/s. */
static int check_units(texture_file *file) {
    static const char *const channels[] = {"acceleration", "speed", "force"}, *const units[] = {"m/s^2", "mm/s", "N"};
    json written = json_member(file->card, "units");
    for (int i = 0; i < 3; i++) {
        json unit = json_member(written, channels[i]);
        if (!json_is_string(unit, units[i]) && !(i == 0 && json_is_string(unit, "relative")))
            return file_refuse(file, FOTEN_BAD_FILE, "the card's %s is not in %s; was the card edited?", channels[i],
                               units[i]);
    }
    return 1;
}

int card_read(foten_model *m, texture_file *file, const card_sizes *s) {
    json card = file->card;
    long long window;
    if (!text_of(json_member(card, "model"), &m->memory, &m->name) ||
        !text_of(json_member(card, "texture"), &m->memory, &m->texture))
        return m->memory.failed ? 0 : file_refuse(file, FOTEN_BAD_FILE, "the card does not name a model and a texture");
    int most = s->order > s->residual_order ? s->order : s->residual_order;
    m->history = s->model == CARD_PLUS ? s->network.window + most + 1 : s->network.window;
    if (!json_integer(json_member(card, "window"), &window) || window != m->history)
        return file_refuse(file, FOTEN_BAD_FILE, "the card's window is not the network's %d", m->history);
    if (!json_number(json_member(card, "rate_hz"), &m->rate_hz) || !(m->rate_hz > 0 && m->rate_hz < 1e9))
        return file_refuse(file, FOTEN_BAD_FILE, "'rate_hz' in the card is not a positive number");
    if (!json_number(json_member(card, "lowpass_hz"), &m->lowpass_hz) ||
        !(m->lowpass_hz > 0 && m->lowpass_hz < m->rate_hz / 2))
        return file_refuse(file, FOTEN_BAD_FILE, "'lowpass_hz' in the card is not between 0 and half of the rate");
    if (!json_number(json_member(card, "saturation"), &m->saturation) ||
        !(m->saturation > 0 && m->saturation <= LARGEST_SATURATION))
        return file_refuse(file, FOTEN_BAD_FILE, "'saturation' in the card is not between 0 and %g standard deviations",
                           LARGEST_SATURATION);
    if (!check_units(file)) return 0;
    json scaling = json_member(card, "scaling"), range = json_member(card, "trained_range"),
         beyond = json_member(card, "extrapolation_exponents");
    if (!numbers(json_member(scaling, "mean"), m->mean, 3) || !numbers(json_member(scaling, "sd"), m->sd, 3))
        return file_refuse(file, FOTEN_BAD_FILE,
                           "the scaling in the card is not three means and three standard deviations");
    for (int i = 0; i < 3; i++)
        if (!(m->sd[i] > 0 && m->sd[i] <= LARGEST[i] && fabs(m->mean[i]) <= LARGEST[i]))
            return file_refuse(file, FOTEN_BAD_FILE,
                               "the card's scaling cannot be: a mean or a standard deviation is beyond %g, or a "
                               "standard deviation is none",
                               LARGEST[i]);
    static const char *const channels[] = {"speed", "force"};
    for (int i = 0; i < 2; i++) {
        double ends[2];
        if (!numbers(json_member(range, channels[i]), ends, 2) ||
            !(ends[0] >= 0 && ends[1] >= ends[0] && ends[1] <= LARGEST[1 + i]))
            return file_refuse(file, FOTEN_BAD_FILE, "the trained range of %s in the card is not [low, high]",
                               channels[i]);
        m->low[i] = ends[0];
        m->high[i] = ends[1];
        if (!json_number(json_member(beyond, channels[i]), &m->exponents[i]) ||
            !(m->exponents[i] >= 0 && m->exponents[i] <= 2))
            return file_refuse(file, FOTEN_BAD_FILE, "the exponent of %s beyond its range is not from 0 to 2",
                               channels[i]);
    }
    return 1;
}
