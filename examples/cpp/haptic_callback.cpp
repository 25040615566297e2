// A texture on a force-feedback device, the way a CHAI3D program has it: the haptic thread gives the tool's speed and force, once a
// millisecond, and adds the vibration along the normal to the force that it sends.
//
//     c++ -std=c++17 -pthread haptic_callback.cpp $(foten doctor --c-flags) -o haptic
//     ./haptic denim.foten
//
// With CHAI3D, `Tool` is a cToolCursor or cGenericHapticDevicePtr: position, velocity and contact force come from it, and the
// result of `TextureOnTool::force` goes to setForce. Here a simulated tool moves for two seconds, so that it runs anywhere.
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "foten.h"

using Vector = std::array<double, 3>; // m, m/s, N

struct Tool {
    Vector velocity;     // m/s
    double contactForce; // N, along the surface's normal
    Vector normal;
};

class TextureOnTool {
public:
    TextureOnTool(const std::string &path, double movedKilograms, double mostNewtons) : mass_(movedKilograms), most_(mostNewtons) {
        if (foten_abi() != FOTEN_ABI) throw std::runtime_error("the foten library is of another version than its header");
        std::ifstream file(path, std::ios::binary);
        if (!file) throw std::runtime_error(path + ": cannot be read");
        std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
        foten_model *model = nullptr;
        char why[256];
        if (foten_model_load(bytes.data(), bytes.size(), &model, why, sizeof why) != FOTEN_OK) throw std::runtime_error(path + ": " + why);
        model_.reset(model);
        rate_ = foten_model_info(model).rate_hz;
        foten_options options{};
        options.smooth = 1; // an encoder's speed is not smooth
        state_.reset(foten_state_new(model, &options));
        if (!state_) throw std::runtime_error("no memory for the state"); // or, of another rate, one that cannot be
    }

    // Once for each tick of the haptic thread, `seconds` after the one before: no allocation, no lock. A haptic thread runs as fast as it
    // can, the texture at its own rate; between two of its samples the last one is held.
    Vector force(const Tool &tool, double seconds) {
        const auto &[x, y, z] = tool.velocity;
        const double along = x * tool.normal[0] + y * tool.normal[1] + z * tool.normal[2];
        const double tangential = std::sqrt(std::fmax(0.0, x * x + y * y + z * z - along * along));
        foten_set_condition(state_.get(), static_cast<float>(1000 * tangential), static_cast<float>(tool.contactForce));
        for (due_ = std::fmin(due_ + seconds * rate_, 100.0); due_ >= 1; due_--) foten_render(state_.get(), &acceleration_, 1);
        const double newtons = std::fmax(-most_, std::fmin(most_, mass_ * acceleration_)); // before it reaches the device
        Vector out;
        for (int i = 0; i < 3; i++) out[i] = newtons * tool.normal[i];
        return out;
    }

private:
    struct FreeModel { void operator()(foten_model *model) const { foten_model_free(model); } };
    struct FreeState { void operator()(foten_state *state) const { foten_state_free(state); } };
    std::unique_ptr<foten_model, FreeModel> model_; // outlives the state
    std::unique_ptr<foten_state, FreeState> state_;
    double mass_; // that moves with the tool: newtons for m/s2
    double most_; // N
    double rate_ = 0, due_ = 0;
    float acceleration_ = 0;
};

int main(int argc, char **argv) {
    if (argc != 2) {
        std::fprintf(stderr, "usage: haptic_callback TEXTURE.foten\n");
        return 2;
    }
    try {
        TextureOnTool texture(argv[1], 0.05, 3.0);
        double energy = 0, largest = 0;
        int late = 0;
        auto due = std::chrono::steady_clock::now();
        constexpr int ticks = 2000;
        for (int tick = 0; tick < ticks; tick++) {
            const double t = tick / 1000.0;
            const Tool tool{{0.12 * std::sin(6.283185307 * t), 0, 0}, 0.8, {0, 0, 1}};
            const Vector force = texture.force(tool, 0.001);
            energy += force[2] * force[2];
            largest = std::fmax(largest, std::fabs(force[2]));
            due += std::chrono::milliseconds(1);
            late += std::chrono::steady_clock::now() > due;
            std::this_thread::sleep_until(due);
        }
        std::printf("%d ticks, %d late; %.3f N rms, %.3f N at most\n", ticks, late, std::sqrt(energy / ticks), largest);
    } catch (const std::exception &error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 2;
    }
}
