#include "model.h"

#include "card.h"
#include "loop.h"

static int read_plus(foten_model *m, texture_file *file, const card_sizes *s) {
    int width = s->excitation_width;
    m->kind = &lattice_loop;
    m->excited_lattice = s->n_tones ? &m->residual : &m->lattice;
    m->network_in_loop = s->network_in_loop && !s->n_tones;
    m->correction_limit = s->correction_limit;
    if (!lattice_read(file, &m->memory, "lattice.", s->n_speed, s->n_force, s->order, width, s->gain_before_filter, &m->lattice)) return 0;
    if (!s->n_tones) return 1;
    if (!tones_read(file, &m->memory, s->n_tones, s->n_tone_speed, s->n_tone_force, &m->tones)) return 0;
    return lattice_read(file, &m->memory, "residual.", s->n_residual_speed, s->n_residual_force, s->residual_order, width,
                        s->residual_gain_before_filter, &m->residual);
}

static int read_network(foten_model *m, texture_file *file, const card_sizes *s, const isa *isa) {
    network *network = network_make(file, s->model == CARD_PLUS ? "network." : "", &s->network, isa, &m->memory);
    m->predictor = (predictor){.window = s->network.window, .n_inputs = s->network.n_inputs, .isa = isa, .network = network};
    return network != NULL;
}

/* Of a graph the file holds nothing for this library but an excitation. */
static int leave_graph(foten_model *m, texture_file *file, const card_sizes *s) {
    m->of_noise = s->of_noise;
    m->predictor.window = s->network.window;
    m->predictor.n_inputs = 3;
    m->predictor.hop = s->hop;
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
    m->kind = &window_loop;
    m->excited = s->excitation;
    if (s->model == CARD_PLUS && !read_plus(m, file, s)) return 0;
    if (m->excited && !excitation_read(file, &m->memory, s->excitation_width, &m->excitation)) return 0;
    return s->model == CARD_GRAPH ? leave_graph(m, file, s) : read_network(m, file, s, isa);
}

foten_status model_read(foten_model *m, texture_file *file, const isa *isa) {
    card_sizes sizes;
    foten_status status = card_read_sizes(file, m->predictor.function != NULL, &sizes);
    if (status == FOTEN_OK) status = card_read(m, file, &sizes);
    if (status != FOTEN_OK) return status;
    if (read_tensors(m, file, &sizes, isa)) return FOTEN_OK;
    return file_refuse(file, m->memory.failed ? FOTEN_NO_MEMORY : FOTEN_BAD_FILE, "no memory");
}
