// Flies an exported policy from a program of your own: observations in, actions and commands out.
//
//   python -m resc.deployment.export policy=policies/obstacles hydra.run.dir=exported
//   g++ -O3 -Iexported examples/cpp/fly_policy.cpp -o fly_policy
//   ./fly_policy < observations.txt
//
// Every line of the input is one control step: the numbers that policy.h lists, scaled and clipped.
// An empty line begins another flight. Every line of the output holds the action, then the command.
#include "policy.h"

#include <cstdio>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

int main() {
    std::vector<float> state(POLICY_STATE);  // what the policy remembers: nothing yet
    for (std::string line; std::getline(std::cin, line);) {
        if (line.empty()) {
            state.assign(POLICY_STATE, 0.0f);
            continue;
        }
        std::istringstream numbers(line);
        float observation[POLICY_OBSERVATIONS], action[POLICY_ACTIONS], command[POLICY_ACTIONS];
        for (float &number : observation) numbers >> number;
        if (!numbers) {
            std::cerr << "expected " << POLICY_OBSERVATIONS << " numbers in: " << line << '\n';
            return 1;
        }
        policy_act(observation, state.data(), action);
        policy_command(action, command);
        for (float number : action) std::printf("%.9g ", number);
        for (float number : command) std::printf("%.9g ", number);
        std::puts("");
    }
}
