// Reads a recording as web viewers do: index, decompression, protobuf by the schemas in the file.
// Prints for each topic how many messages it has and how many numbers they hold.
//
//   NODE_PATH=.cache/node/node_modules node tests/recording/list_messages.cjs FILE
//
// `make readers` installs the packages there and runs the test that calls this.

const { open } = require("node:fs/promises");
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const protobuf = require("protobufjs");
const descriptor = require("protobufjs/ext/descriptor");

function numbersIn(value) {
  if (typeof value === "number" || typeof value === "boolean") {
    return 1;
  }
  const parts = typeof value === "object" && value !== null ? Object.values(value) : [];
  return parts.reduce((sum, part) => sum + numbersIn(part), 0);
}

async function main(path) {
  const file = await open(path, "r");
  const reader = await McapIndexedReader.Initialize({
    readable: {
      size: async () => (await file.stat({ bigint: true })).size,
      read: async (offset, size) =>
        (await file.read(new Uint8Array(Number(size)), 0, Number(size), Number(offset))).buffer,
    },
    decompressHandlers: await loadDecompressHandlers(),
  });
  const found = {};
  const types = new Map();
  for (const channel of reader.channelsById.values()) {
    const schema = reader.schemasById.get(channel.schemaId);
    const files = descriptor.FileDescriptorSet.decode(schema.data);
    types.set(channel.id, protobuf.Root.fromDescriptor(files).lookupType(schema.name));
    found[channel.topic] = { messages: 0, numbers: 0 };
  }
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const entry = found[reader.channelsById.get(message.channelId).topic];
    const type = types.get(message.channelId);
    const content = type.toObject(type.decode(message.data), { defaults: true, longs: Number });
    entry.messages += 1;
    entry.numbers += numbersIn(content);
  }
  await file.close();
  console.log(JSON.stringify(found));
}

main(process.argv[2]);
